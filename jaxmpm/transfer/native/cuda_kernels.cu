// The transfers on a GPU, compiled once per scalar type (JAXMPM_SCALAR). See cuda.h.

#include "cuda.h"

namespace jaxmpm {
namespace {

#define JAXMPM_BOTH static __host__ __device__ __forceinline__
#define JAXMPM_NUMBER constexpr __host__ __device__
#define JAXMPM_APART
#include "stencil.h"

constexpr int kWarp = 32;
constexpr int kThreads = 128;           // in a block of particles
constexpr int kShared = 48 * 1024;      // bytes of shared memory that every GPU gives a block
constexpr int kGroup = 4;               // channels that are worked on together

// Derivatives that a group of channels meets, as bits: weights, their first derivatives, their second ones.
constexpr int kValues = 1, kSlopes = 2, kCurvatures = 4;

JAXMPM_NUMBER int order_of(int kinds) { return kinds >= kCurvatures ? 2 : kinds >= kSlopes ? 1 : 0; }
JAXMPM_NUMBER int first_jet(int kinds) { return kinds & kValues ? 0 : 1; }
JAXMPM_NUMBER int jets_of(int dimension, int kinds) {
  return kinds ? jets(dimension, order_of(kinds)) - first_jet(kinds) : 0;
}
JAXMPM_NUMBER int power_of_three(int exponent) { return exponent == 0 ? 1 : 3 * power_of_three(exponent - 1); }
JAXMPM_NUMBER int padded_to_four(int count) { return (count + 3) / 4 * 4; }
// Four times an odd number: records of this length, one after the other, start in different banks.
JAXMPM_NUMBER int record_of(int count) { return padded_to_four(count) / 4 % 2 ? padded_to_four(count) : padded_to_four(count) + 4; }

template <class T>
struct alignas(16) Four {
  T of[kGroup];
};

template <class T>
struct alignas(2 * sizeof(T)) Two {
  T of[2];
};

// Where a particle lies: coordinates in cells, the lowest node of its stencil along each axis.
template <class T, int D>
struct Place {
  T cells[D];
  int32_t base[D];
};

// The stencil lies on the grid whatever the position.
template <class T>
__device__ __forceinline__ void locate(const Axes<T>& axes, int axis, T at, T& cells, int32_t& base) {
  cells = (at - axes.origin[axis]) / axes.cell;
  const T lowest = floor(cells - T(0.5));
  base = lowest > 0 ? static_cast<int32_t>(lowest < axes.highest[axis] ? lowest : axes.highest[axis]) : 0;
}

template <class T, int D>
__device__ __forceinline__ Place<T, D> place_of(const Axes<T>& axes, const T* position, int64_t p) {
  Place<T, D> place;
#pragma unroll
  for (int axis = 0; axis < D; ++axis) {
    locate(axes, axis, position[axis * axes.particles + p], place.cells[axis], place.base[axis]);
  }
  return place;
}

// Rows of the nodes of a lane: those of a column follow each other. NEAR: nodes near soil alone are stored.
template <bool NEAR>
struct Rows {
  const int32_t* first;  // see Plan
  int32_t stored;

  __device__ __forceinline__ Rows(const Lanes& of, int64_t lane, int32_t stored)
      : first(static_cast<const int32_t*>(of.data) + lane * of.step), stored(stored) {}

  // The row of the node of this number in a column.
  __device__ __forceinline__ int64_t of(int64_t column, int32_t levels, int32_t number) const {
    if constexpr (NEAR) return int64_t{first[column]} + number;
    return column * levels + number;
  }
  // The first of so many rows, which an array has. Where soil reaches more nodes than are stored, rows mean nothing.
  __device__ __forceinline__ int64_t within(int64_t row, int32_t count = 1) const {
    if constexpr (NEAR) return row < 0 ? 0 : row < stored - count ? row : stored - count;
    return row;
  }
};

// Value and derivatives (1/m, 1/m2) of the shape function of a node of a particle's stencil along an axis.
template <class T, int D, int ORDER>
__device__ __forceinline__ void weight_at(const Axes<T>& axes, const Place<T, D>& place, int axis, int node, T (&of)[ORDER + 1]) {
  T slope = 0, curvature = 0;
  shape<T, ORDER>(axes.function, axes.half[axis], axes.per_half[axis], place.cells[axis] - T(place.base[axis] + node), &of[0],
                  &slope, &curvature);
  if constexpr (ORDER > 0) of[1] = slope * axes.per_cell;
  if constexpr (ORDER > 1) of[2] = curvature * axes.per_cell * axes.per_cell;
}

// The weight of a node derived as `jet` tells, from those along each axis.
template <class T, int D, int ORDER>
__device__ __forceinline__ T product(const T (&along)[D][ORDER + 1], int jet) {
  T result = along[0][order_along<D>(jet, 0)];
#pragma unroll
  for (int axis = 1; axis < D; ++axis) result *= along[axis][order_along<D>(jet, axis)];
  return result;
}

// What a particle of a lane brings to `COUNT` channels from `first` on through a derivative. Most meet one row or none, so that
// these are read before any is used.
template <class T, int COUNT>
__device__ __forceinline__ void read_brought(const Terms& terms, int32_t lane, int32_t p, int jet, int first, T (&to)[COUNT]) {
  const auto read = [&](const Terms::Entry& entry) { return static_cast<const T*>(entry.data)[int64_t{lane} * entry.step + p]; };
  const auto* const start = terms.start + jet * kMaxChannels + first;
#pragma unroll
  for (int c = 0; c < COUNT; ++c) to[c] = start[c] < start[c + 1] ? read(terms.entry[start[c]]) : T(0);
#pragma unroll
  for (int c = 0; c < COUNT; ++c) {
    if (start[c] == start[c + 1]) continue;
    to[c] *= T(terms.entry[start[c]].factor);
    for (int t = start[c] + 1; t < start[c + 1]; ++t) to[c] += T(terms.entry[t].factor) * read(terms.entry[t]);
  }
}

// ------------------------------------------------------------------------------------------ particles to nodes

template <int W>
__device__ __forceinline__ void add_to(float* at, const float (&sums)[W]) {
#pragma unroll
  for (int c = 0; c < W; c += kGroup) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    asm volatile("red.relaxed.gpu.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(at + c), "f"(sums[c]), "f"(sums[c + 1]),
                 "f"(sums[c + 2]), "f"(sums[c + 3])
                 : "memory");
#else
    for (int i = c; i < c + kGroup; ++i) atomicAdd(at + i, sums[i]);
#endif
  }
}
template <int W>
__device__ __forceinline__ void add_to(double* at, const double (&sums)[W]) {
#pragma unroll
  for (int c = 0; c < W; ++c) atomicAdd(at + c, sums[c]);
}

// What `add_to` leaves where it adds to a number: it takes subnormal floats as 0.
template <class T>
__device__ __forceinline__ T added(T to, T value) {
#if defined(JAXMPM_CUDA_ON_CPU)
  return cuda_on_cpu::added(to, value);
#else
  if constexpr (sizeof(T) == sizeof(float)) asm("add.ftz.f32 %0, %0, %1;" : "+f"(to) : "f"(value));
  else to += value;
  return to;
#endif
}

// The columns that a launch sums: all along the last axis but one, every `every`-th along the one before, from `first` on.
struct Columns {
  int32_t first, every, along_first, along_second;
};

// The row that a channel meets through a derivative, or the first of several.
struct Slot {
  const void* data;
  int32_t step;
  float factor;  // 0 for none
};

template <class T>
struct ScatterGiven {
  Axes<T> axes;
  Cut cut;
  Columns columns;
  Order order;
  Lanes position, nodal, first;  // `nodal` of the first copy
  int32_t stored;
  int64_t copy;           // numbers from one copy to the next
  Slot slots[kMaxJets * kGroup];
  bool several;           // rows for some slot
  Terms terms;
};

// FIRST and SECOND are the kinds of derivatives that the first and the second four channels meet; 0 without a second four.
// USED are the channels that are met, as bits.
template <class T, int D, int FIRST, int SECOND, int USED>
struct Scatter {
  static constexpr int kOrder = order_of(FIRST) > order_of(SECOND) ? order_of(FIRST) : order_of(SECOND);
  static constexpr int kWidth = SECOND ? 2 * kGroup : kGroup;
  static constexpr int kNodes = power_of_three(D), kColumns = kNodes / kStencil;
  static constexpr int kWeights = padded_to_four(D * kStencil * (kOrder + 1));
  static constexpr int kFirst = jets_of(D, FIRST) * kGroup, kSecond = jets_of(D, SECOND) * kGroup;
  // The bucket of slot i, and whether its channel is used.
  JAXMPM_NUMBER static int bucket_of(int i) {
    return i < kFirst ? (first_jet(FIRST) + i / kGroup) * kMaxChannels + i % kGroup
                      : (first_jet(SECOND) + (i - kFirst) / kGroup) * kMaxChannels + kGroup + i % kGroup;
  }
  JAXMPM_NUMBER static bool is_used(int i) { return USED >> (bucket_of(i) % kMaxChannels) & 1; }
  // A particle's weights, then what it brings to each channel through each derivative.
  static constexpr int kRecord = record_of(kWeights + kFirst + kSecond);
  // Sums at the two lowest nodes of each segment, of the segment itself and of the one below.
  struct Edges {
    T own[2][kColumns][kWidth], below[2][kColumns][kWidth];
  };
  // Warps of a block, and bytes of shared memory, for a column of so many segments.
  static constexpr int kRecords = kWarp * kRecord * static_cast<int>(sizeof(T));
  static int edges_of(int segments) { return segments > 1 ? segments + 1 : 0; }
  static int warps_of(int segments) {
    return std::min(segments, (kShared - edges_of(segments) * static_cast<int>(sizeof(Edges))) / kRecords);
  }
  static int bytes_of(int segments) { return edges_of(segments) * static_cast<int>(sizeof(Edges)) + warps_of(segments) * kRecords; }
  static_assert(kRecords + (kSegments + 1) * static_cast<int>(sizeof(Edges)) <= kShared, "a warp exceeds the shared memory");
  static constexpr int kShares = kWarp / kNodes;  // lanes that share a node: each sums every kShares-th particle
};

// A warp's sums of a segment. Lane n sums for node n % kNodes of the stencil.
template <class T, int D, int FIRST, int SECOND, int USED>
struct SegmentSums {
  using S = Scatter<T, D, FIRST, SECOND, USED>;
  static constexpr unsigned kAll = 0xffffffffu;
  T sums[S::kWidth];
  int32_t held;  // lowest node along the last axis that `sums` belongs to; -1 for none
  int32_t lane, node, share, last;

  __device__ __forceinline__ explicit SegmentSums(int32_t lane_of_warp)
      : held(-1), lane(lane_of_warp), node(lane % S::kNodes), share(lane / S::kNodes), last(node % kStencil) {
#pragma unroll
    for (int c = 0; c < S::kWidth; ++c) sums[c] = 0;
  }

  // Goes on to the stencil one node up the last axis: `put` takes the sums at the node that it does not reach.
  template <class Put>
  __device__ __forceinline__ void move_up(Put put) {
#pragma unroll
    for (int c = 0; c < S::kWidth; ++c) {
      if (!(USED >> c & 1)) continue;
      T rest = 0;
#pragma unroll
      for (int s = 1; s < S::kShares; ++s) rest += __shfl_sync(kAll, sums[c], node + s * S::kNodes < kWarp ? node + s * S::kNodes : lane);
      sums[c] = share == 0 ? sums[c] + rest : T(0);
    }
    if (share == 0 && last == 0) put(held, sums);
#pragma unroll
    for (int c = 0; c < S::kWidth; ++c) {
      if (!(USED >> c & 1)) continue;
      const T above = __shfl_down_sync(kAll, sums[c], 1);
      sums[c] = share > 0 || last == kStencil - 1 ? T(0) : above;
    }
    ++held;
  }

  // Adds what a particle brings to the node.
  __device__ __forceinline__ void add(const T* record) {
    if (share >= S::kShares) return;
    T along[D][S::kOrder + 1];
    const int at[3] = {D == 3 ? node / 9 : D == 2 ? node / 3 : node, D == 3 ? node / 3 % 3 : node % 3, node % 3};
#pragma unroll
    for (int axis = 0; axis < D; ++axis) {
      const T* const from = record + (axis * kStencil + at[axis]) * (S::kOrder + 1);
      if constexpr (S::kOrder == 1) {
        const Two<T> two = *reinterpret_cast<const Two<T>*>(from);
        along[axis][0] = two.of[0];
        along[axis][1] = two.of[1];
      } else {
#pragma unroll
        for (int o = 0; o <= S::kOrder; ++o) along[axis][o] = from[o];
      }
    }
    add_group<FIRST, 0>(along, record + S::kWeights);
    if constexpr (SECOND != 0) add_group<SECOND, kGroup>(along, record + S::kWeights + S::kFirst);
  }

  template <int KINDS, int FROM>
  __device__ __forceinline__ void add_group(const T (&along)[D][S::kOrder + 1], const T* brought) {
#pragma unroll
    for (int j = 0; j < jets_of(D, KINDS); ++j) {
      const T weight = product<T, D, S::kOrder>(along, first_jet(KINDS) + j);
      const Four<T> four = *reinterpret_cast<const Four<T>*>(brought + j * kGroup);
#pragma unroll
      for (int c = 0; c < kGroup; ++c) {
        if (USED >> (FROM + c) & 1) sums[FROM + c] += weight * four.of[c];
      }
    }
  }
};

template <class T, int D, int FIRST, int SECOND, int USED>
__device__ __forceinline__ void fill_record(const ScatterGiven<T>& given, int32_t lane, int32_t p, const Place<T, D>& place,
                                            T* record) {
  using S = Scatter<T, D, FIRST, SECOND, USED>;
  constexpr int kSlots = S::kFirst + S::kSecond;
  T brought[kSlots];
#pragma unroll
  for (int i = 0; i < kSlots; ++i) {
    const Slot& slot = given.slots[i];
    brought[i] = S::is_used(i) ? static_cast<const T*>(slot.data)[int64_t{lane} * slot.step + p] : T(0);
  }
#pragma unroll
  for (int axis = 0; axis < D; ++axis) {
#pragma unroll
    for (int k = 0; k < kStencil; ++k) {
      T of[S::kOrder + 1];
      weight_at<T, D, S::kOrder>(given.axes, place, axis, k, of);
#pragma unroll
      for (int o = 0; o <= S::kOrder; ++o) record[(axis * kStencil + k) * (S::kOrder + 1) + o] = of[o];
    }
  }
#pragma unroll
  for (int i = 0; i < kSlots; ++i) {
    const T factor = T(given.slots[i].factor);
    if (S::is_used(i)) brought[i] = factor == 0 ? T(0) : factor * brought[i];
  }
  if (given.several) {
#pragma unroll
    for (int i = 0; i < kSlots; ++i) {
      const Terms& terms = given.terms;
      for (int t = terms.start[S::bucket_of(i)] + 1; t < terms.start[S::bucket_of(i) + 1]; ++t) {
        const Terms::Entry& entry = terms.entry[t];
        brought[i] += T(entry.factor) * static_cast<const T*>(entry.data)[int64_t{lane} * entry.step + p];
      }
    }
  }
#pragma unroll
  for (int i = 0; i < kSlots; ++i) record[S::kWeights + i] = brought[i];
}

template <bool NEAR, class T, int D, int FIRST, int SECOND, int USED>
__global__ void __launch_bounds__(kWarp * kSegments) scatter_columns(const __grid_constant__ ScatterGiven<T> given) {
  using S = Scatter<T, D, FIRST, SECOND, USED>;
  JAXMPM_SHARED(memory);
  const Axes<T>& axes = given.axes;
  const Cut cut = given.cut;
  const int32_t lane_of_warp = threadIdx.x % kWarp, warp = threadIdx.x / kWarp, warps = blockDim.x / kWarp;
  const bool cut_up = cut.count > 1;
  typename S::Edges* const edges = reinterpret_cast<typename S::Edges*>(memory);
  T* const records = reinterpret_cast<T*>(memory + (cut_up ? (cut.count + 1) * sizeof(typename S::Edges) : 0)) + warp * kWarp * S::kRecord;

  // The column of this block, and its lane.
  const int64_t of_lane = int64_t{given.columns.along_first} * given.columns.along_second;
  const int32_t lane = static_cast<int32_t>(blockIdx.x / of_lane);
  const int32_t number = static_cast<int32_t>(blockIdx.x % of_lane), along_second = given.columns.along_second;
  const int32_t x = D == 3 ? given.columns.first + given.columns.every * (number / along_second) : D == 2 ? number : 0;
  const int32_t y = D == 3 ? number % along_second : 0;
  const int32_t second_nodes = D == 3 ? axes.nodes[1] : 1, last_nodes = axes.nodes[D - 1];
  const int64_t all_columns = D == 1 ? 1 : int64_t{axes.nodes[0]} * second_nodes;
  const int64_t column = (given.order.shared ? 0 : int64_t{lane} * all_columns) + int64_t{x} * second_nodes + y;
  const int32_t* const offsets = given.order.offsets + column * last_nodes;
  if (offsets[0] == offsets[last_nodes]) return;
  if (cut_up) {
    constexpr int kNumbers = static_cast<int>(sizeof(typename S::Edges) / sizeof(T));
    for (int i = threadIdx.x; i < (cut.count + 1) * kNumbers; i += blockDim.x) reinterpret_cast<T*>(edges)[i] = 0;
    __syncthreads();
  }

  const T* const position = static_cast<const T*>(given.position.data) + lane * given.position.step;
  T* const nodal = static_cast<T*>(given.nodal.data) + int64_t{lane} * given.nodal.step;
  const auto copy_of = [&](int32_t dx, int32_t dy) { return D == 1 ? 0 : D == 2 ? dx : given.columns.every == 1 ? kStencil * dy + dx : dy; };
  const Rows<NEAR> rows(given.first, lane, given.stored);
  // The copy for a column of the stencil, and the row of a node in it.
  const auto copy_at = [&](int32_t of_column) {
    return nodal + (D == 3 ? copy_of(of_column / kStencil, of_column % kStencil) : copy_of(of_column, 0)) * given.copy;
  };
  const auto row_of = [&](int32_t of_column, int32_t z) {
    const int32_t dx = D == 3 ? of_column / kStencil : of_column, dy = D == 3 ? of_column % kStencil : 0;
    return rows.of(D == 1 ? 0 : int64_t{x + dx} * second_nodes + y + dy, last_nodes, z);
  };
  for (int32_t segment = warp; segment < cut.count; segment += warps) {
    const int32_t start = segment * cut.length, stop = start + cut.length;
    const int32_t begin = offsets[start], end = offsets[stop < last_nodes ? stop : last_nodes];
    if (begin >= end) continue;
    SegmentSums<T, D, FIRST, SECOND, USED> sums(lane_of_warp);
    const int32_t of_column = sums.node / kStencil;
    const int64_t lowest = row_of(of_column, 0);
    T* const from_node = copy_at(of_column) + (NEAR ? 0 : lowest * S::kWidth);
    const auto put = [&](int32_t z, const T (&at_node)[S::kWidth]) {
      const int32_t level = z - start;
      if (!cut_up || (level >= 2 && level < cut.length)) {
        add_to(from_node + (NEAR ? rows.within(lowest + z) : z) * S::kWidth, at_node);
        return;
      }
      T* const edge = level < 2 ? edges[segment].own[level][of_column] : edges[segment + 1].below[level - cut.length][of_column];
#pragma unroll
      for (int c = 0; c < S::kWidth; ++c) edge[c] = at_node[c];
    };
    const auto listed = [&](int32_t i) { return given.order.list[i < end ? i : end - 1]; };
    int32_t p = listed(begin + lane_of_warp);
    for (int32_t from = begin; from < end; from += kWarp) {
      const int32_t count = end - from < kWarp ? end - from : kWarp;
      const Place<T, D> place = place_of<T, D>(axes, position, p);
      fill_record<T, D, FIRST, SECOND, USED>(given, lane, p, place, records + lane_of_warp * S::kRecord);
      p = listed(from + kWarp + lane_of_warp);
      const int32_t cell = place.base[D - 1], before = __shfl_up_sync(sums.kAll, cell, 1);
      unsigned heads = __ballot_sync(sums.kAll, lane_of_warp < count && (lane_of_warp == 0 || before != cell));
      __syncwarp();
      while (heads) {
        const int32_t first = __ffs(heads) - 1;
        heads &= heads - 1;
        const int32_t after = heads ? __ffs(heads) - 1 : count, next = __shfl_sync(sums.kAll, cell, first);
        if (sums.held < 0) sums.held = next;
        // Three moves leave nothing behind.
        for (int32_t moves = next - sums.held < kStencil ? next - sums.held : kStencil; moves > 0; --moves) sums.move_up(put);
        sums.held = next;
        for (int32_t i = first + sums.share; i < after; i += S::kShares) sums.add(records + i * S::kRecord);
      }
      __syncwarp();
    }
    for (int k = 0; k < kStencil; ++k) sums.move_up(put);
  }
  if (!cut_up) return;
  __syncthreads();
  // The two lowest nodes of each segment, and the two above the last one.
  for (int item = threadIdx.x; item < (cut.count + 1) * 2 * S::kColumns; item += blockDim.x) {
    const int32_t segment = item / (2 * S::kColumns), level = item / S::kColumns % 2, of_column = item % S::kColumns;
    const int32_t z = segment * cut.length + level;
    if (z >= last_nodes) continue;
    T both[S::kWidth];
    bool some = false;
#pragma unroll
    for (int c = 0; c < S::kWidth; ++c) {
      both[c] = edges[segment].below[level][of_column][c] + edges[segment].own[level][of_column][c];
      some |= both[c] != 0;
    }
    if (some) add_to(copy_at(of_column) + rows.within(row_of(of_column, z)) * S::kWidth, both);
  }
}

// Sums copies, COPIES of each, of which those for columns along the first axis are summed in the order of launches for them.
template <class T, int COPIES>
__global__ void __launch_bounds__(kThreads) sum_copies(const T* copies, int64_t count, int64_t fours_of_plane, int32_t planes, T* nodal) {
  const int64_t i = int64_t{blockIdx.x} * kThreads + threadIdx.x;
  if (i >= count) return;
  const auto four = [&](int64_t copy) { return reinterpret_cast<const Four<T>*>(copies)[copy * count + i]; };
  const int plane = static_cast<int>(i / fours_of_plane % planes % kStencil);
  Four<T> sum{};
#pragma unroll
  for (int second = 0; second < kStencil; ++second) {
    Four<T> part = COPIES == kStencil ? four(second) : Four<T>{};
#pragma unroll
    for (int launch = 0; launch < (COPIES == kStencil ? 0 : kStencil); ++launch) {
      const Four<T> next = four(kStencil * second + (plane + kStencil - launch) % kStencil);
#pragma unroll
      for (int c = 0; c < kGroup; ++c) part.of[c] = added(part.of[c], next.of[c]);
    }
#pragma unroll
    for (int c = 0; c < kGroup; ++c) sum.of[c] += part.of[c];
  }
  reinterpret_cast<Four<T>*>(nodal)[i] = sum;
}

template <class T, int D, int FIRST, int SECOND, int USED>
bool launch_scatter(const Transfer& transfer) {
  using S = Scatter<T, D, FIRST, SECOND, USED>;
  const Plan& plan = transfer.plan;
  const int64_t of_lane = plan.nodes * S::kWidth, of_all = transfer.lanes * of_lane;
  const bool near = transfer.first.data != nullptr;
  const auto kernel = near ? scatter_columns<(D > 1), T, D, FIRST, SECOND, USED> : scatter_columns<false, T, D, FIRST, SECOND, USED>;
  const int copies = copies_of(D, of_all, near);
  ScatterGiven<T> given{Axes<T>(plan), cut_of(plan), {}, transfer.order, transfer.position, transfer.nodal, transfer.first,
                        static_cast<int32_t>(plan.nodes), of_all};
  given.terms = transfer.terms;
  for (int i = 0; i < S::kFirst + S::kSecond; ++i) {
    const int start = given.terms.start[S::bucket_of(i)], end = given.terms.start[S::bucket_of(i) + 1];
    const Terms::Entry& entry = given.terms.entry[start];
    given.slots[i] = start < end ? Slot{entry.data, entry.step, entry.factor} : Slot{transfer.position.data, 0, 0};
    given.several |= end - start > 1;
  }
  if (copies > 0) given.nodal = {transfer.copies, of_lane};
  cudaMemsetAsync(given.nodal.data, 0, sizeof(T) * of_all * std::max(copies, 1), transfer.stream);
  const int threads = kWarp * S::warps_of(given.cut.count), bytes = S::bytes_of(given.cut.count);
  const int launches = D == 3 && copies == kStencil ? kStencil : 1;
  for (int first = 0; first < launches; ++first) {
    const int32_t along_first = D == 3 ? (plan.shape[0] - kStencil - first) / launches + 1 : 1;
    given.columns = {first, launches, plan.shape[0] - kStencil < first ? 0 : along_first, D == 1 ? 1 : plan.shape[D - 2] - kStencil + 1};
    const int64_t blocks = transfer.lanes * given.columns.along_first * given.columns.along_second;
    if (blocks > INT32_MAX) return false;
    if (blocks > 0) {
      JAXMPM_LAUNCH(kernel, static_cast<unsigned>(blocks), threads, bytes, transfer.stream, given);
    }
  }
  if constexpr (D > 1) {
    const int64_t count = of_all / kGroup, blocks = (count + kThreads - 1) / kThreads, plane = of_lane / plan.shape[0] / kGroup;
    if (blocks > INT32_MAX) return false;
    if (blocks == 0) return true;
    const T* const from = static_cast<const T*>(transfer.copies);
    T* const to = static_cast<T*>(transfer.nodal.data);
    if (copies == kStencil) {
      JAXMPM_LAUNCH((sum_copies<T, kStencil>), static_cast<unsigned>(blocks), kThreads, 0, transfer.stream, from, count, plane, plan.shape[0], to);
    } else {
      JAXMPM_LAUNCH((sum_copies<T, kStencil * kStencil>), static_cast<unsigned>(blocks), kThreads, 0, transfer.stream, from, count, plane, plan.shape[0], to);
    }
  }
  return true;
}

// ------------------------------------------------------------------------------------------ nodes to particles

template <class T>
struct GatherGiven {
  Axes<T> axes;
  int32_t blocks_of_lane, stored;
  Lanes position, nodal, slope, rows, first;
  Terms terms;
};

// Sums over a particle's stencil of derivatives of the weights times the channels, W of them.
template <class T, int D, int W, int KINDS>
struct StencilSums {
  static constexpr int kOrder = order_of(KINDS), kCount = jets_of(D, KINDS), kFirst = first_jet(KINDS);
  T of[kCount][W];

  template <bool NEAR>
  __device__ __forceinline__ StencilSums(const Axes<T>& axes, const Place<T, D>& place, const Rows<NEAR>& rows,
                                         const T* __restrict__ nodal) {
    T weights[D][kStencil][kOrder + 1];
    // The first column of the stencil; the row of its lowest node, of each column's where nodes near soil alone are stored.
    int64_t corner = 0, lowest = 0;
#pragma unroll
    for (int axis = 0; axis < D; ++axis) {
      lowest = lowest * axes.nodes[axis] + place.base[axis];
      if (axis == D - 2) corner = lowest;
#pragma unroll
      for (int k = 0; k < kStencil; ++k) weight_at<T, D, kOrder>(axes, place, axis, k, weights[axis][k]);
    }
#pragma unroll
    for (int j = 0; j < kCount; ++j) {
#pragma unroll
      for (int c = 0; c < W; ++c) of[j][c] = 0;
    }
#pragma unroll
    for (int n = 0; n < power_of_three(D); ++n) {
      const int at[3] = {D == 3 ? n / 9 : D == 2 ? n / 3 : n, D == 3 ? n / 3 % 3 : n % 3, n % 3};
      int64_t column = 0;
#pragma unroll
      for (int axis = 0; axis < D - 1; ++axis) column = column * axes.nodes[axis] + at[axis];
      if (NEAR && at[D - 1] == 0) lowest = rows.within(rows.of(corner + column, 0, place.base[D - 1]), kStencil);
      const int64_t node = NEAR ? at[D - 1] : column * axes.nodes[D - 1] + at[D - 1];
      T along[D][kOrder + 1], values[W];
#pragma unroll
      for (int axis = 0; axis < D; ++axis) {
#pragma unroll
        for (int o = 0; o <= kOrder; ++o) along[axis][o] = weights[axis][at[axis]][o];
      }
      read(nodal + (lowest + node) * W, values);
#pragma unroll
      for (int j = 0; j < kCount; ++j) {
        const T weight = product<T, D, kOrder>(along, kFirst + j);
#pragma unroll
        for (int c = 0; c < W; ++c) of[j][c] += weight * values[c];
      }
    }
  }

  static __device__ __forceinline__ void read(const T* __restrict__ from, T (&values)[W]) {
    if constexpr (W == 1) {
      values[0] = *from;
    } else {
#pragma unroll
      for (int c = 0; c < W; c += kGroup) {
        const Four<T> four = *reinterpret_cast<const Four<T>*>(from + c);
#pragma unroll
        for (int i = 0; i < kGroup; ++i) values[c + i] = four.of[i];
      }
    }
  }

  // The rows of a transfer to particles.
  __device__ __forceinline__ void write(const Terms& terms, int jets_below, T* rows, int64_t particles, int64_t p) const {
#pragma unroll
    for (int j = 0; j < kCount; ++j) {
      if (kFirst + j >= jets_below) continue;
#pragma unroll
      for (int c = 0; c < W; ++c) {
        const int bucket = (kFirst + j) * kMaxChannels + c;
        for (int t = terms.start[bucket]; t < terms.start[bucket + 1]; ++t) {
          const Terms::Entry& entry = terms.entry[t];
          T* const at = rows + entry.row * particles + p;
          const T share = T(entry.factor) * of[j][c];
          *at = entry.first ? share : *at + share;
        }
      }
    }
  }
};

template <bool NEAR, class T, int D, int W, int KINDS>
__global__ void __launch_bounds__(kThreads) gather_particles(const __grid_constant__ GatherGiven<T> given) {
  const int64_t lane = blockIdx.x / given.blocks_of_lane, particles = given.axes.particles;
  const int64_t p = int64_t{blockIdx.x % given.blocks_of_lane} * kThreads + threadIdx.x;
  if (p >= particles) return;
  const T* const position = static_cast<const T*>(given.position.data) + lane * given.position.step;
  const T* const nodal = static_cast<const T*>(given.nodal.data) + lane * given.nodal.step;
  const Rows<NEAR> rows(given.first, lane, given.stored);
  const StencilSums<T, D, W, KINDS> sums(given.axes, place_of<T, D>(given.axes, position, p), rows, nodal);
  sums.write(given.terms, kMaxJets, static_cast<T*>(given.rows.data) + lane * given.rows.step, particles, p);
}

// ORDER is one above that of the terms.
template <bool NEAR, class T, int D, int W, int ORDER>
__global__ void __launch_bounds__(kThreads) contract_particles(const __grid_constant__ GatherGiven<T> given) {
  const int64_t lane = blockIdx.x / given.blocks_of_lane, particles = given.axes.particles;
  const int64_t p = int64_t{blockIdx.x % given.blocks_of_lane} * kThreads + threadIdx.x;
  if (p >= particles) return;
  const T* const position = static_cast<const T*>(given.position.data) + lane * given.position.step;
  const T* const nodal = static_cast<const T*>(given.nodal.data) + lane * given.nodal.step;
  constexpr int kKinds = ORDER == 2 ? kValues | kSlopes | kCurvatures : kValues | kSlopes;
  const Rows<NEAR> rows(given.first, lane, given.stored);
  const StencilSums<T, D, W, kKinds> sums(given.axes, place_of<T, D>(given.axes, position, p), rows, nodal);
  T slope[D] = {};
#pragma unroll
  for (int j = 0; j < jets(D, ORDER - 1); ++j) {
    T brought[W];
    read_brought<T, W>(given.terms, static_cast<int32_t>(lane), static_cast<int32_t>(p), j, 0, brought);
#pragma unroll
    for (int c = 0; c < W; ++c) {
#pragma unroll
      for (int axis = 0; axis < D; ++axis) slope[axis] += brought[c] * sums.of[derived<D>(j, axis)][c];
    }
  }
  T* const slopes = static_cast<T*>(given.slope.data) + lane * given.slope.step;
#pragma unroll
  for (int axis = 0; axis < D; ++axis) slopes[axis * particles + p] = slope[axis];
  if (given.rows.data == nullptr) return;
  sums.write(given.terms, jets(D, ORDER - 1), static_cast<T*>(given.rows.data) + lane * given.rows.step, particles, p);
}

template <class T>
bool take(const Transfer& transfer, GatherGiven<T>& given, int64_t& blocks) {
  const int64_t of_lane = (transfer.plan.particles + kThreads - 1) / kThreads;
  given = {Axes<T>(transfer.plan), static_cast<int32_t>(of_lane), static_cast<int32_t>(transfer.plan.nodes), transfer.position,
           transfer.nodal, transfer.slope, transfer.rows, transfer.first, transfer.terms};
  blocks = of_lane * transfer.lanes;
  return blocks <= INT32_MAX;
}

// ------------------------------------------------------------------------------------------ which kernel

// Derivatives that the channels from `first` on, W of them, meet.
int kinds_of(const Plan& plan, const Terms& terms, int first, int width) {
  int kinds = 0;
  for (int jet = 0; jet < jets(plan.dimension, 2); ++jet) {
    const int start = terms.start[jet * kMaxChannels + first], end = terms.start[jet * kMaxChannels + first + width];
    if (start < end) kinds |= jet == 0 ? kValues : jet <= plan.dimension ? kSlopes : kCurvatures;
  }
  return kinds;
}

template <class T, int D>
bool scatter_of(const Transfer& transfer) {
  constexpr int kBoth = kValues | kSlopes, kFour = 0xf, kEight = 0xff;
  // Channels of the usual transfers: momentum alone; mass and momentum, then force.
  constexpr int kMomentum = (1 << D) - 1, kMassMomentum = (1 << (D + 1)) - 1, kAndForce = kMassMomentum | kMomentum << kGroup;
  const int first = kinds_of(transfer.plan, transfer.terms, 0, kGroup);
  int used = 0;
  for (int t = 0; t < transfer.plan.term_count; ++t) used |= 1 << transfer.plan.terms[t].channel;
  if (transfer.plan.width == kGroup) {
    if (first <= kValues && (used | kMomentum) == kMomentum) return launch_scatter<T, D, kValues, 0, kMomentum>(transfer);
    if (first <= kValues) return launch_scatter<T, D, kValues, 0, kFour>(transfer);
    if (first < kCurvatures) return launch_scatter<T, D, kBoth, 0, kFour>(transfer);
    return launch_scatter<T, D, kBoth | kCurvatures, 0, kFour>(transfer);
  }
  const int second = kinds_of(transfer.plan, transfer.terms, kGroup, kGroup);
  if (first >= kCurvatures || second >= kCurvatures) return false;
  if (first <= kValues && second <= kValues) return launch_scatter<T, D, kValues, kValues, kEight>(transfer);
  if (first <= kValues && second == kSlopes && (used | kAndForce) == kAndForce) {
    return launch_scatter<T, D, kValues, kSlopes, kAndForce>(transfer);
  }
  return launch_scatter<T, D, kBoth, kBoth, kEight>(transfer);
}

template <class T, int D, int W, int KINDS>
bool launch_gather(const Transfer& transfer) {
  GatherGiven<T> given{Axes<T>(transfer.plan)};
  int64_t blocks;
  if (!take(transfer, given, blocks)) return false;
  if (blocks > 0) {
    const auto kernel = transfer.first.data ? gather_particles<(D > 1), T, D, W, KINDS> : gather_particles<false, T, D, W, KINDS>;
    JAXMPM_LAUNCH(kernel, static_cast<unsigned>(blocks), kThreads, 0, transfer.stream, given);
  }
  return true;
}

template <class T, int D>
bool gather_of(const Transfer& transfer) {
  const int width = transfer.plan.stride, kinds = kinds_of(transfer.plan, transfer.terms, 0, width);
  constexpr int kBoth = kValues | kSlopes, kAllKinds = kBoth | kCurvatures;
  if (width == 1 && kinds <= kValues) return launch_gather<T, D, 1, kValues>(transfer);
  if (width == 1 && kinds <= kBoth) return launch_gather<T, D, 1, kBoth>(transfer);
  if (width == 1) return launch_gather<T, D, 1, kAllKinds>(transfer);
  if (width == 4 && kinds <= kValues) return launch_gather<T, D, 4, kValues>(transfer);
  if (width == 4 && kinds == kSlopes) return launch_gather<T, D, 4, kSlopes>(transfer);
  if (width == 4 && kinds <= kBoth) return launch_gather<T, D, 4, kBoth>(transfer);
  if (width == 4) return launch_gather<T, D, 4, kAllKinds>(transfer);
  if (width == 8 && kinds <= kValues) return launch_gather<T, D, 8, kValues>(transfer);
  if (width == 8 && kinds <= kBoth) return launch_gather<T, D, 8, kBoth>(transfer);
  return false;
}

template <class T, int D, int W, int ORDER>
bool launch_contract(const Transfer& transfer) {
  GatherGiven<T> given{Axes<T>(transfer.plan)};
  int64_t blocks;
  if (!take(transfer, given, blocks)) return false;
  if (blocks > 0) {
    const auto kernel = transfer.first.data ? contract_particles<(D > 1), T, D, W, ORDER> : contract_particles<false, T, D, W, ORDER>;
    JAXMPM_LAUNCH(kernel, static_cast<unsigned>(blocks), kThreads, 0, transfer.stream, given);
  }
  return true;
}

template <class T, int D>
bool contract_of(const Transfer& transfer) {
  const int width = transfer.plan.stride, order = transfer.plan.order;
  if (width == 1 && order == 1) return launch_contract<T, D, 1, 1>(transfer);
  if (width == 1 && order == 2) return launch_contract<T, D, 1, 2>(transfer);
  if (width == 4 && order == 1) return launch_contract<T, D, 4, 1>(transfer);
  if (width == 4 && order == 2) return launch_contract<T, D, 4, 2>(transfer);
  if (width == 8 && order == 1) return launch_contract<T, D, 8, 1>(transfer);
  return false;
}

template <class T>
bool scatter(const Transfer& t) {
  return t.plan.dimension == 1 ? scatter_of<T, 1>(t) : t.plan.dimension == 2 ? scatter_of<T, 2>(t) : scatter_of<T, 3>(t);
}
template <class T>
bool gather(const Transfer& t) {
  return t.plan.dimension == 1 ? gather_of<T, 1>(t) : t.plan.dimension == 2 ? gather_of<T, 2>(t) : gather_of<T, 3>(t);
}
template <class T>
bool contract(const Transfer& t) {
  return t.plan.dimension == 1 ? contract_of<T, 1>(t) : t.plan.dimension == 2 ? contract_of<T, 2>(t) : contract_of<T, 3>(t);
}

}  // namespace

#define JAXMPM_JOIN_OF(a, b) a##_##b
#define JAXMPM_JOIN(a, b) JAXMPM_JOIN_OF(a, b)
using Number = JAXMPM_SCALAR;
extern const CudaKernels JAXMPM_JOIN(cuda, JAXMPM_SCALAR) = {scatter<Number>, gather<Number>, contract<Number>};

}  // namespace jaxmpm
