// Particles in the order of their stencils or cells: counted, placed by the sums of the counts, and put in the order of their
// numbers within each place. See cuda.h.

#include "cuda.h"

#if defined(JAXMPM_CUDA_ON_CPU)
#include <cmath>
#else
#include <cub/device/device_scan.cuh>
#endif

namespace jaxmpm {
namespace {

constexpr int kThreads = 256;

constexpr int64_t rounded(int64_t bytes) { return (bytes + 255) / 256 * 256; }
// What summing so many counts takes: some bytes for each thousand, and some.
constexpr int64_t kept_to_sum(int64_t places) { return rounded(places / 16 + (int64_t{1} << 20)); }

// The place of each particle, its number among those that were counted there (-1 for none), and who was placed where.
struct Placed {
  int32_t *place, *number, *who;
  void* room;

  Placed(void* scratch, int64_t particles) {
    char* const at = static_cast<char*>(scratch);
    const int64_t size = rounded(4 * particles);
    place = reinterpret_cast<int32_t*>(at);
    number = reinterpret_cast<int32_t*>(at + size);
    who = reinterpret_cast<int32_t*>(at + 2 * size);
    room = at + 3 * size;
  }
};

__device__ __forceinline__ int64_t item_of_thread() { return int64_t{blockIdx.x} * blockDim.x + threadIdx.x; }

template <class T>
struct Axis {
  T origin;
  int32_t nodes;
};
template <class T>
struct Grid {
  Axis<T> axes[kAxes];
  T cell;
  int32_t dimension;
};

// Counts particles by the lowest nodes of their stencils, those of a lane after those of the lane before.
template <class T>
__global__ void count_by_stencil(Grid<T> grid, int64_t particles, int64_t count, const T* position, Placed placed, int32_t* counts) {
  const int64_t i = item_of_thread();
  if (i >= count) return;
  const int64_t lane = i / particles, p = i % particles;
  int64_t place = lane;
  bool near = true;
  for (int axis = 0; axis < grid.dimension; ++axis) {
    const Axis<T> of = grid.axes[axis];
    const T cells = (position[(lane * grid.dimension + axis) * particles + p] - of.origin) / grid.cell;
    const T lowest = floor(cells - T(0.5)), highest = T(of.nodes - kStencil);
    place = place * of.nodes + (lowest > 0 ? static_cast<int32_t>(lowest < highest ? lowest : highest) : 0);
    near = near && cells > -2 && cells < T(of.nodes + 1);
  }
  placed.place[i] = static_cast<int32_t>(place);
  placed.number[i] = near ? atomicAdd(counts + place, 1) : -1;
}

__global__ void count_by_cell(int64_t particles, int64_t count, int64_t cells, const int32_t* cell, Placed placed, int32_t* counts) {
  const int64_t i = item_of_thread();
  if (i >= count) return;
  const int64_t place = i / particles * cells + (cell[i] < 0 ? 0 : cell[i] < cells ? cell[i] : cells - 1);
  placed.place[i] = static_cast<int32_t>(place);
  placed.number[i] = atomicAdd(counts + place, 1);
}

__global__ void put_in_place(int64_t count, Placed placed, const int32_t* offsets) {
  const int64_t i = item_of_thread();
  if (i < count && placed.number[i] >= 0) placed.who[offsets[placed.place[i]] + placed.number[i]] = static_cast<int32_t>(i);
}

// The order in which particles were counted is that of chance: each goes to where its number belongs in its place.
__global__ void order_places(int64_t particles, int64_t places, Placed placed, const int32_t* offsets, int32_t* list) {
  const int64_t at = item_of_thread();
  if (at >= offsets[places]) return;
  const int32_t who = placed.who[at], place = placed.place[who], begin = offsets[place], end = offsets[place + 1];
  int32_t before = 0;
  for (int32_t k = begin; k < end; ++k) before += placed.who[k] < who;
  list[begin + before] = static_cast<int32_t>(who % particles);
}

// The sums of a cell. `shared` tells that all lanes have the order of the first.
template <class T>
__global__ void sum_cells(int64_t cells, int64_t count, bool shared, const int32_t* list, const int32_t* offsets, int64_t rows,
                          int64_t particles, const T* values, int64_t step, T* sums) {
  const int64_t i = item_of_thread();
  if (i >= count) return;
  const int64_t lane = i / cells, place = shared ? i % cells : i;
  const int32_t begin = offsets[place], end = offsets[place + 1];
  for (int64_t row = 0; row < rows && begin < end; ++row) {
    const T* const from = values + lane * step + row * particles;
    T sum = 0;
    for (int32_t j = begin; j < end; ++j) sum += from[list[j]];
    T* const to = sums + (lane * rows + row) * particles;
    for (int32_t j = begin; j < end; ++j) to[list[j]] = sum;
  }
}

unsigned blocks_for(int64_t count) { return static_cast<unsigned>((count + kThreads - 1) / kThreads); }

// Fills the order of particles that `count_them` counts, in `places` places.
template <class Count>
const char* order_by(Count count_them, int64_t particles, int64_t of_all, int64_t places, const Placed& placed, const Order& order,
                     cudaStream_t stream) {
  if (cudaMemsetAsync(order.offsets, 0, sizeof(int32_t) * (places + 1), stream) != cudaSuccess) return "offsets cannot be cleared";
  if (of_all == 0) return nullptr;
  count_them();
#if defined(JAXMPM_CUDA_ON_CPU)
  for (int64_t k = 0, sum = 0; k <= places; ++k) sum += std::exchange(order.offsets[k], static_cast<int32_t>(sum));
#else
  std::size_t needed = 0, kept = static_cast<std::size_t>(kept_to_sum(places));
  const int count = static_cast<int>(places + 1);
  cudaError_t error = cub::DeviceScan::ExclusiveSum(nullptr, needed, order.offsets, order.offsets, count, stream);
  if (error == cudaSuccess && needed > kept) return "sums of counts need more memory than they were given";
  if (error == cudaSuccess) error = cub::DeviceScan::ExclusiveSum(placed.room, kept, order.offsets, order.offsets, count, stream);
  if (error != cudaSuccess) return cudaGetErrorString(error);
#endif
  JAXMPM_LAUNCH(put_in_place, blocks_for(of_all), kThreads, 0, stream, of_all, placed, order.offsets);
  JAXMPM_LAUNCH(order_places, blocks_for(of_all), kThreads, 0, stream, particles, places, placed, order.offsets, order.list);
  return nullptr;
}

template <class T>
const char* put_lanes_in_order(const Plan& plan, int64_t lanes, const T* position, const Order& order, void* scratch,
                               cudaStream_t stream) {
  Grid<T> grid{{}, T(plan.cell), plan.dimension};
  int64_t nodes = 1;
  for (int axis = 0; axis < plan.dimension; ++axis) {
    grid.axes[axis] = {T(plan.origin[axis]), plan.shape[axis]};
    nodes *= plan.shape[axis];
  }
  const int64_t count = lanes * plan.particles;
  const Placed placed(scratch, count);
  const auto count_them = [&] {
    JAXMPM_LAUNCH((count_by_stencil<T>), blocks_for(count), kThreads, 0, stream, grid, plan.particles, count, position, placed,
                  order.offsets);
  };
  return order_by(count_them, plan.particles, count, lanes * nodes, placed, order, stream);
}

template <class T>
const char* sum_lanes(int64_t lanes, int64_t rows, int64_t particles, int64_t cells, Lanes cell, Lanes values, T* sums, void* scratch,
                      cudaStream_t stream) {
  const bool shared = cell.step == 0;
  const int64_t ordered = shared ? 1 : lanes, count = ordered * particles, places = ordered * cells;
  const Placed placed(scratch, count);
  char* const after = static_cast<char*>(placed.room) + kept_to_sum(places);
  const Order order{reinterpret_cast<int32_t*>(after), reinterpret_cast<int32_t*>(after + rounded(4 * count)), shared};
  const auto count_them = [&] {
    JAXMPM_LAUNCH(count_by_cell, blocks_for(count), kThreads, 0, stream, particles, count, cells, static_cast<const int32_t*>(cell.data),
                  placed, order.offsets);
  };
  if (const char* fault = order_by(count_them, particles, count, places, placed, order, stream)) return fault;
  if (count == 0 || lanes == 0) return nullptr;
  JAXMPM_LAUNCH((sum_cells<T>), blocks_for(lanes * cells), kThreads, 0, stream, cells, lanes * cells, shared, order.list, order.offsets,
                rows, particles, static_cast<const T*>(values.data), values.step, sums);
  return nullptr;
}

}  // namespace

cudaError_t try_kernels(int device) {
  int before = 0;
  cudaError_t error = cudaGetDevice(&before);
  if (error == cudaSuccess) error = cudaSetDevice(device);
  cudaFuncAttributes attributes;
  if (error == cudaSuccess) error = cudaFuncGetAttributes(&attributes, reinterpret_cast<const void*>(&put_in_place));
  cudaSetDevice(before);
  cudaGetLastError();  // which the next call would take for its own
  return error;
}

int64_t bytes_to_order(int64_t particles, int64_t places) {
  return 4 * rounded(4 * particles) + kept_to_sum(places) + rounded(4 * (places + 1));
}

const char* put_in_order(const Plan& plan, Scalar scalar, int64_t lanes, const void* position, const Order& order, void* scratch,
                         cudaStream_t stream) {
  if (scalar == Scalar::kFloat) return put_lanes_in_order(plan, lanes, static_cast<const float*>(position), order, scratch, stream);
  return put_lanes_in_order(plan, lanes, static_cast<const double*>(position), order, scratch, stream);
}

const char* sum_in_cells(Scalar scalar, int64_t lanes, int64_t rows, int64_t particles, int64_t cells, Lanes cell, Lanes values,
                         void* sums, void* scratch, cudaStream_t stream) {
  if (scalar == Scalar::kFloat) {
    return sum_lanes(lanes, rows, particles, cells, cell, values, static_cast<float*>(sums), scratch, stream);
  }
  return sum_lanes(lanes, rows, particles, cells, cell, values, static_cast<double*>(sums), scratch, stream);
}

}  // namespace jaxmpm
