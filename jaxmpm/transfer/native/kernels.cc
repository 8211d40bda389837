// The transfers of a range of particles, compiled once per instruction set and scalar type (JAXMPM_ISA, JAXMPM_SCALAR).
//
// A particle's weights are products of three numbers per axis. The sums over its stencil are therefore nested: what
// is common to a row of three nodes along the last axis is computed once per row, so that a node costs one fused
// multiply-add per derivative along that axis. A node's channels are one vector.

#include "kernels.h"

#if defined(__AVX512F__)
#include <immintrin.h>
#if !defined(__clang__)
// GCC's own header reads what it calls undefined.
#pragma GCC diagnostic ignored "-Wuninitialized"
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#endif

namespace jaxmpm {
namespace {

#if defined(__AVX512F__)
constexpr int kVectorBytes = 64;
#elif defined(__AVX2__)
constexpr int kVectorBytes = 32;
#else
constexpr int kVectorBytes = 16;
#endif
constexpr int kBlock = kVectorBytes == 64 ? 64 : 32;  // particles whose weights are computed together, as vectors

#define JAXMPM_INLINE static inline __attribute__((always_inline))
#define JAXMPM_MEMBER inline __attribute__((always_inline))
#define JAXMPM_BOTH JAXMPM_INLINE
#define JAXMPM_NUMBER constexpr

// What runs once for a block of particles is compiled once for all kernels that call it.
#if defined(__clang__)
#define JAXMPM_APART __attribute__((noinline))
#else
#define JAXMPM_APART __attribute__((noinline, noclone))
#endif

// Numbers in the first machine vector of a pack: the largest power of two.
template <class T>
constexpr int first_of(int width) {
  int lanes = kVectorBytes / sizeof(T);
  while (lanes > width) lanes /= 2;
  return lanes;
}

// A machine vector; of one number, that itself, so that the compiler vectorises loops over it.
template <class T, int N>
struct Vector {
  typedef T Type __attribute__((vector_size(N * sizeof(T))));
};
template <class T>
struct Vector<T, 1> {
  using Type = T;
};

// W numbers, a node's channels or a row of nodes, as few machine vectors as hold them.
template <class T, int W>
struct Pack {
  static constexpr int kFirst = first_of<T>(W);
  typename Vector<T, kFirst>::Type first;
  Pack<T, W - kFirst> rest;
};
template <class T>
struct Pack<T, 0> {};

template <class T, int W>
JAXMPM_INLINE Pack<T, W> load(const T* from) {
  Pack<T, W> r;
  __builtin_memcpy(&r.first, from, sizeof r.first);
  if constexpr (W > r.kFirst) r.rest = load<T, W - r.kFirst>(from + r.kFirst);
  return r;
}
template <class T, int W>
JAXMPM_INLINE void store(T* to, const Pack<T, W>& a) {
  __builtin_memcpy(to, &a.first, sizeof a.first);
  if constexpr (W > a.kFirst) store<T, W - a.kFirst>(to + a.kFirst, a.rest);
}
template <class V, class T, int W>
JAXMPM_INLINE Pack<T, W> scaled(const V& all, const Pack<T, W>& a) {
  if constexpr (W == 0) {
    return {};
  } else {
    decltype(a.first) low;
    __builtin_memcpy(&low, &all, sizeof low);
    return {low * a.first, scaled(all, a.rest)};
  }
}
// A load brings the number to all lanes of a vector. From a register it would take a port that products need.
template <class T, int W>
JAXMPM_INLINE Pack<T, W> operator*(T s, const Pack<T, W>& a) {
  if constexpr (W == a.kFirst) {
    return {s * a.first, {}};
  } else {
    decltype(a.first) all = s - decltype(a.first){};
#if defined(__AVX512F__)
    asm("" : "+v"(all));
#endif
    return scaled(all, a);
  }
}
template <class T, int W>
JAXMPM_INLINE Pack<T, W> operator+(const Pack<T, W>& a, const Pack<T, W>& b) {
  if constexpr (W == 0) return {};
  else return {a.first + b.first, a.rest + b.rest};
}
template <class T, int W>
JAXMPM_INLINE Pack<T, W> operator*(const Pack<T, W>& a, const Pack<T, W>& b) {
  if constexpr (W == 0) return {};
  else return {a.first * b.first, a.rest * b.rest};
}

#include "stencil.h"
#include "weights.h"

// What one node of an axis gives a particle: weight, slope (1/m) and curvature (1/m2).
template <class T>
struct AxisWeight {
  T w, s, c;
};

template <class T, int D, int ORDER>
JAXMPM_INLINE AxisWeight<T> weight_of(const Weights<T, D, ORDER>& weights, int axis, int node, int p) {
  const auto& of = weights.of[axis][node];
  return {of[0][p], ORDER > 0 ? of[ORDER > 0 ? 1 : 0][p] : T(0), ORDER > 1 ? of[ORDER > 1 ? 2 : 0][p] : T(0)};
}

// A particle's coefficients, one pack per derivative. Second derivatives stand in the order
// 3D: xx, xy, xz, yy, yz, zz; 2D: xx, xz, zz; 1D: xx.
template <class T, int W, int J>
struct Jet {
  Pack<T, W> d[J];
};

// Sum over the first of D axes, which leaves coefficients of the D - 1 others: the product rule on one axis.
template <class T, int W, int D, int ORDER>
JAXMPM_INLINE Jet<T, W, jets(D - 1, ORDER)> lower(const Jet<T, W, jets(D, ORDER)>& a, AxisWeight<T> at) {
  Jet<T, W, jets(D - 1, ORDER)> r;
  r.d[0] = at.w * a.d[0];
  if constexpr (ORDER > 0) {
    r.d[0] = r.d[0] + at.s * a.d[1];
    for (int j = 1; j < D; ++j) r.d[j] = at.w * a.d[1 + j];
  }
  if constexpr (ORDER > 1) {
    r.d[0] = r.d[0] + at.c * a.d[1 + D];
    for (int j = 1; j < D; ++j) r.d[j] = r.d[j] + at.s * a.d[1 + D + j];
    for (int j = 0; j < D * (D - 1) / 2; ++j) r.d[D + j] = at.w * a.d[1 + 2 * D + j];
  }
  return r;
}

// The transpose of `lower`: adds what one node of the first axis holds to the sums of D axes.
template <class T, int W, int D, int ORDER>
JAXMPM_INLINE void raise(const Jet<T, W, jets(D - 1, ORDER)>& a, AxisWeight<T> at, Jet<T, W, jets(D, ORDER)>& r) {
  r.d[0] = r.d[0] + at.w * a.d[0];
  if constexpr (ORDER > 0) {
    r.d[1] = r.d[1] + at.s * a.d[0];
    for (int j = 1; j < D; ++j) r.d[1 + j] = r.d[1 + j] + at.w * a.d[j];
  }
  if constexpr (ORDER > 1) {
    r.d[1 + D] = r.d[1 + D] + at.c * a.d[0];
    for (int j = 1; j < D; ++j) r.d[1 + D + j] = r.d[1 + D + j] + at.s * a.d[j];
    for (int j = 0; j < D * (D - 1) / 2; ++j) r.d[1 + 2 * D + j] = r.d[1 + 2 * D + j] + at.w * a.d[D + j];
  }
}

// Rows of a stencil in D dimensions: three nodes along the last axis, which follow each other.
constexpr int rows_of(int dimension) { return dimension == 1 ? 1 : dimension == 2 ? 3 : 9; }

// Numbers from a node to the next along each axis of an array of this shape.
template <int D>
struct Strides {
  int64_t of[D];

  JAXMPM_MEMBER Strides(int64_t stride, const int32_t* shape) {
    for (int axis = D - 1; axis >= 0; --axis) {
      of[axis] = stride;
      stride *= shape[axis];
    }
  }

  // To node n of the stencil of the first A axes.
  template <int A>
  JAXMPM_MEMBER int64_t to(int n) const {
    int64_t offset = 0;
#pragma GCC unroll 3
    for (int axis = A - 1; axis >= 0; --axis, n /= kStencil) offset += n % kStencil * of[axis];
    return offset;
  }
};

constexpr int32_t kOneStencil[kAxes] = {kStencil, kStencil, kStencil};

// Where the rows of a stencil lie in the nodal array.
template <int D>
struct NodeRows {
  const int32_t* first;
  int32_t levels;
  int64_t stride, last;     // of nodes; lowest node of the last row that lies in the array
  int64_t columns[rows_of(D)];  // from that of the lowest node to that of each row
  int64_t of[rows_of(D)];   // numbers from where the stencil starts to the first node of each row

  JAXMPM_APART explicit NodeRows(const Plan& plan)
      : first(plan.first), levels(plan.shape[D - 1]), stride(plan.stride), last(plan.nodes - kStencil) {
    for (int row = 0; row < rows_of(D); ++row) {
      columns[row] = D == 3 ? int64_t{row / kStencil} * plan.shape[1] + row % kStencil : int64_t{row};
      of[row] = columns[row] * levels * stride;
    }
  }

  // Where the stencil with this lowest node starts; for other rows than those stored on the array all the same.
  JAXMPM_MEMBER int64_t start(int32_t node) {
    if (!first) return node * stride;
    const int32_t column = node / levels, level = node - column * levels;
    for (int row = 0; row < rows_of(D); ++row) {
      const int64_t lowest = int64_t{first[column + columns[row]]} + level;
      of[row] = (lowest < 0 ? 0 : lowest > last ? last : lowest) * stride;
    }
    return 0;
  }
};

// The nodes of one stencil in an array of their own, W numbers each at most; a load of PAST numbers may start at any.
template <class T, int D, int W, int PAST>
struct OneStencil {
  NodeRows<D> rows;
  Strides<D> strides;
  int32_t base = -1;  // its lowest node
  alignas(64) T of[rows_of(D) * kStencil * W + PAST] = {};

  JAXMPM_APART explicit OneStencil(const Plan& plan) : rows(plan), strides(plan.stride, kOneStencil) {}

  JAXMPM_APART void read(const T* nodal, int32_t node) {
    base = node;
    const T* const from = nodal + rows.start(node);
    const int64_t count = kStencil * rows.stride;
    for (int row = 0; row < rows_of(D); ++row) {
      for (int i = 0; i < count; ++i) of[row * count + i] = from[rows.of[row] + i];
    }
  }

  // Writes what has been read back.
  JAXMPM_APART void write(T* nodal) {
    if (base < 0) return;
    T* const to = nodal + rows.start(base);
    const int64_t count = kStencil * rows.stride;
    for (int row = 0; row < rows_of(D); ++row) {
      for (int i = 0; i < count; ++i) to[rows.of[row] + i] = of[row * count + i];
    }
  }
};

// One particle to its stencil, from axis number D_ALL - D on.
template <class T, int W, int D, int ORDER, int D_ALL>
JAXMPM_INLINE void spread(const Jet<T, W, jets(D, ORDER)>& a, const Weights<T, D_ALL, ORDER>& weights, int p,
                          const Strides<D_ALL>& strides, T* node) {
  if constexpr (D == 0) {
    store<T, W>(node, load<T, W>(node) + a.d[0]);
  } else {
    constexpr int axis = D_ALL - D;
#pragma GCC unroll 3
    for (int k = 0; k < kStencil; ++k) {
      const AxisWeight<T> at = weight_of(weights, axis, k, p);
      spread<T, W, D - 1, ORDER, D_ALL>(lower<T, W, D, ORDER>(a, at), weights, p, strides, node + k * strides.of[axis]);
    }
  }
}

// One particle's sums over its stencil, from axis number D_ALL - D on; the last LEFT axes lie within a pack, and `pack(n)` is
// the one of number n, those of the last axis first.
template <class T, int W, int D, int ORDER, int D_ALL, int LEFT = 0, class Packs>
JAXMPM_INLINE Jet<T, W, jets(D - LEFT, ORDER)> collect(const Weights<T, D_ALL, ORDER>& weights, int p, const Packs& pack,
                                                       int n = 0) {
  Jet<T, W, jets(D - LEFT, ORDER)> r = {};
  if constexpr (D == LEFT) {
    r.d[0] = pack(n);
  } else {
    constexpr int axis = D_ALL - D;
#pragma GCC unroll 3
    for (int k = 0; k < kStencil; ++k) {
      const AxisWeight<T> at = weight_of(weights, axis, k, p);
      raise<T, W, D - LEFT, ORDER>(
          collect<T, W, D - 1, ORDER, D_ALL, LEFT>(weights, p, pack, kStencil * n + k), at, r);
    }
  }
  return r;
}

// The packs that a block of particles brings to its nodes, one per derivative; `to` starts as zeros.
template <class T, int W, int J>
JAXMPM_APART void fill_coefficients(const Plan& plan, const void* const* rows, const Block& block,
                                     T (&coefficients)[J][kBlock][W]) {
  for (int t = 0; t < plan.term_count; ++t) {
    const Term& term = plan.terms[t];
    const T* from = static_cast<const T*>(rows[term.row]) + (block.list ? 0 : block.first);
    const T factor = T(term.factor);
    T* to = &coefficients[term.jet][0][term.channel];
    if (!term.first_at_node) {
      for (int p = 0; p < block.count; ++p) to[p * W] += factor * from[block.list ? block.list[p] : p];
    } else if (block.list) {
      for (int p = 0; p < block.count; ++p) to[p * W] = factor * from[block.list[p]];
    } else {
      for (int p = 0; p < block.count; ++p) to[p * W] = factor * from[p];
    }
  }
}

template <class T, int D, int W, int ORDER>
void scatter(const Plan& plan, const T* __restrict position, const void* const* rows, const int32_t* index, int64_t begin,
             int64_t end, T* __restrict nodal) {
  constexpr int J = jets(D, ORDER);
  const Axes<T> axes(plan);
  Weights<T, D, ORDER> weights;
  alignas(64) T coefficients[J][kBlock][W] = {};
  OneStencil<T, D, W, W> near(plan);
  const Strides<D> strides = plan.first ? near.strides : Strides<D>(plan.stride, plan.shape);
  for (int64_t from = begin; from < end; from += kBlock) {
    const Block block(index, from, end);
    fill_weights(axes, Positions<T, D>(axes, position, block), weights);
    fill_coefficients(plan, rows, block, coefficients);
    for (int p = 0; p < block.count; ++p) {
      Jet<T, W, J> a;
#pragma GCC unroll 10
      for (int j = 0; j < J; ++j) a.d[j] = load<T, W>(coefficients[j][p]);
      if (plan.first && weights.node[p] != near.base) {
        near.write(nodal);
        near.read(nodal, weights.node[p]);
      }
      T* const node = plan.first ? near.of : nodal + int64_t{weights.node[p]} * plan.stride;
      spread<T, W, D, ORDER, D>(a, weights, p, strides, node);
    }
  }
  near.write(nodal);
}

// The jet of D axes that is `jet` of the first D - 1 of them, derived `order` times along the last one.
template <int D>
constexpr int extended(int jet, int order) {
  int result = 0, of_two = jet - D;
  if (jet > 0 && jet < D) result = jet;
  for (int i = 0; i < D - 1 && jet >= D; ++i) {
    for (int j = i; j < D - 1; ++j, --of_two) {
      if (of_two == 0) result = derived<D>(1 + i, j);
    }
  }
  for (; order > 0; --order) result = derived<D>(result, D - 1);
  return result;
}

#if defined(__AVX512F__)
#include "runs.h"
#endif

// Sums along the last axis of a particle's sums over the others, whose three nodes lie `stride` numbers apart.
template <class T, int W, int L, int D, int ORDER>
JAXMPM_INLINE Jet<T, W, jets(D, ORDER)> along_last(const Weights<T, D, ORDER>& weights, int p, int stride,
                                                   const T (*sums)[kBlock][L]) {
  Jet<T, W, jets(D, ORDER)> r;
#pragma GCC unroll 3
  for (int order = 0; order <= ORDER; ++order) {
    const int count = jets(D - 1, ORDER - order);
#pragma GCC unroll 6
    for (int j = 0; j < count; ++j) {
      const T* from = sums[j][p];
      Pack<T, W>& to = r.d[extended<D>(j, order)];
      to = weights.of[D - 1][0][order][p] * load<T, W>(from);
      to = to + weights.of[D - 1][1][order][p] * load<T, W>(from + stride);
      to = to + weights.of[D - 1][2][order][p] * load<T, W>(from + 2 * stride);
    }
  }
  return r;
}

// Numbers in a row: the three nodes of a stencil along the last axis, which follow each other, with W channels each. 0
// where sums over rows do not stay in registers: beyond two vectors, beyond one for second derivatives, and for several
// channels with 16 registers.
template <class T, int W, int ORDER>
constexpr int row_of() {
  constexpr int lanes = kVectorBytes / sizeof(T);
  if (W == 1) return 4;
  const int row = kStencil * W < lanes ? lanes : kStencil * W, second = row - lanes;
  const bool fits = second == 0 || (ORDER < 2 && first_of<T>(second) == second);
  return kVectorBytes == 64 && fits ? row : 0;
}

// Blocks of particles with their sums over the stencil, a pack per derivative: calls `before(block)` for a block,
// `each(p, sums)` for its particles, `after(its first particle, count)`. A pack holds a row of nodes (L numbers), whose sums the
// weights along the last axis multiply; with L = 0 it holds one node. With AVX-512 rows stay in registers while particles
// with the same stencil follow each other.
template <class T, int D, int W, int ORDER, int L, class Before, class Each, class After>
JAXMPM_INLINE void for_sums(const Plan& plan, const T* __restrict position, const T* __restrict nodal, int64_t begin, int64_t end, Before before,
                            Each each, After after) {
  constexpr int LEFT = L > 0, P = L > 0 ? L : W, J = jets(D - LEFT, ORDER);
  constexpr int kPacks = D - LEFT == 0 ? 1 : D - LEFT == 1 ? 3 : D - LEFT == 2 ? 9 : 27;
  constexpr bool kHeld = kVectorBytes == 64 && LEFT == 1;
  const Axes<T> axes(plan);
  Weights<T, D, ORDER> weights;
  alignas(64) T sums[J][L > 0 ? kBlock : 1][P] = {};
  OneStencil<T, D, W, P> apart(plan);  // near nodes, and a stencil whose last pack would end beyond the array
  const Strides<D> dense(plan.stride, plan.shape);
  const int64_t highest = plan.nodes * plan.stride - P - dense.template to<D - LEFT>(kPacks - 1);
  const int32_t stride = plan.stride;
  const auto collected = [&](int p, const auto& pack) { return collect<T, P, D, ORDER, D, LEFT>(weights, p, pack); };
  for (int64_t from = begin; from < end; from += kBlock) {
    const Block block(nullptr, from, end);
    fill_weights(axes, Positions<T, D>(axes, position, block), weights);
    before(block);
    // Within the block: what lives across calls lives in memory.
    Pack<T, P> packs[kHeld ? kPacks : 1] = {};
    int32_t base = -1;  // lowest node of the stencil that `packs` belongs to
    for (int p = 0; p < block.count; ++p) {
      Jet<T, P, J> r;
      if (!kHeld || weights.node[p] != base) {
        base = weights.node[p];
        const bool within = __builtin_expect(!plan.first && int64_t{base} * stride <= highest, 1);
        if (!within && base != apart.base) apart.read(nodal, base);
        const T* const node = within ? nodal + int64_t{base} * stride : apart.of;
        const Strides<D>& strides = within ? dense : apart.strides;
        const auto read = [&](int n) { return load<T, P>(node + strides.template to<D - LEFT>(n)); };
        if constexpr (kHeld) {
#pragma GCC unroll 9
          for (int n = 0; n < kPacks; ++n) packs[n] = read(n);
        } else {
          r = collected(p, read);
        }
      }
      if constexpr (kHeld) r = collected(p, [&](int n) { return packs[n]; });
      if constexpr (LEFT == 0) {
        each(p, r);
      } else {
#pragma GCC unroll 6
        for (int j = 0; j < J; ++j) store<T, P>(sums[j][p], r.d[j]);
      }
    }
    // A loop of its own, since a load of a part of what has just been stored waits; over a whole block for the compiler.
    for (int p = 0; LEFT && p < kBlock; ++p) {
      if constexpr (LEFT == 1) each(p, along_last<T, W, L, D, ORDER>(weights, p, stride, sums));
    }
    after(from, block.count);
  }
}

// The sums of a block, kept for `write_rows`.
template <class T, int W, int J>
struct Kept {
  alignas(64) T sums[J][kBlock][W];

  template <int M>
  JAXMPM_MEMBER void keep(int p, const Jet<T, W, M>& r) {
#pragma GCC unroll 10
    for (int j = 0; j < J; ++j) store<T, W>(sums[j][p], r.d[j]);
  }

  // What `gather` answers with.
  JAXMPM_APART void write_rows(const Plan& plan, int64_t block, int count, T* rows) const {
    alignas(64) T columns[J][W][kBlock];
    uint32_t wanted = 0;
    for (int t = 0; t < plan.term_count; ++t) wanted |= 1u << plan.terms[t].jet;
    for (int j = 0; j < J; ++j) {
      // Whole blocks, so that the compiler transposes them by shuffles.
      if (!(wanted >> j & 1)) continue;
      for (int p = 0; p < kBlock; ++p) {
#pragma GCC unroll 8
        for (int c = 0; c < W; ++c) columns[j][c][p] = sums[j][p][c];
      }
    }
    for (int t = 0; t < plan.term_count; ++t) {
      const Term& term = plan.terms[t];
      T* to = rows + term.row * plan.particles + block;
      const T* from = columns[term.jet][term.channel];
      const T factor = T(term.factor);
      if (term.first_at_row) {
        for (int p = 0; p < count; ++p) to[p] = factor * from[p];
      } else {
        for (int p = 0; p < count; ++p) to[p] += factor * from[p];
      }
    }
  }
};

template <class T, int D, int W, int ORDER, int L>
void gather(const Plan& plan, const T* __restrict position, const T* __restrict nodal, int64_t begin, int64_t end,
            T* __restrict rows) {
  Kept<T, W, jets(D, ORDER)> kept;
  for_sums<T, D, W, ORDER, L>(
      plan, position, nodal, begin, end, [](const Block&) {}, [&](int p, const auto& sums) { kept.keep(p, sums); },
      [&](int64_t block, int count) { kept.write_rows(plan, block, count, rows); });
}

// Numbers that a pack of `width` is added up to as vectors.
constexpr int folded_width(int width) { return width < 4 ? width : 4; }

// A pack whose numbers have the same sum.
template <class T, int W>
JAXMPM_INLINE auto folded(const Pack<T, W>& a) {
  constexpr int N = folded_width(W);
  T of[W];
  store<T, W>(of, a);
  auto sum = load<T, N>(of);
#pragma GCC unroll 2
  for (int i = N; i < W; i += N) sum = sum + load<T, N>(of + i);
  return sum;
}

// Rows times the nodal field that they meet, derived along the position, and what `gather` answers with unless
// `gathered` is null; the weights have one order more than the terms.
template <class T, int D, int W, int ORDER, int L>
void contract(const Plan& plan, const T* __restrict position, const T* __restrict nodal, const void* const* rows,
              int64_t begin, int64_t end, T* __restrict slope, T* __restrict gathered) {
  constexpr int J = jets(D, ORDER - 1);
  alignas(64) T coefficients[J][kBlock][W] = {};
  constexpr int N = folded_width(W);
  alignas(64) T along[D][kBlock][N] = {}, columns[D][kBlock];
  Kept<T, W, J> kept;
  for_sums<T, D, W, ORDER, L>(
      plan, position, nodal, begin, end,
      [&](const Block& block) { fill_coefficients(plan, rows, block, coefficients); },
      [&](int p, const auto& sums) {
#pragma GCC unroll 3
        for (int axis = 0; axis < D; ++axis) {
          Pack<T, W> product = load<T, W>(coefficients[0][p]) * sums.d[derived<D>(0, axis)];
#pragma GCC unroll 4
          for (int j = 1; j < J; ++j) product = product + load<T, W>(coefficients[j][p]) * sums.d[derived<D>(j, axis)];
          store<T, N>(along[axis][p], folded(product));
        }
        if (gathered) kept.keep(p, sums);
      },
      [&](int64_t block, int count) {
        if (gathered) kept.write_rows(plan, block, count, gathered);
        for (int axis = 0; axis < D; ++axis) {
          for (int p = 0; p < kBlock; ++p) {
            columns[axis][p] = along[axis][p][0];
#pragma GCC unroll 3
            for (int i = 1; i < N; ++i) columns[axis][p] += along[axis][p][i];
          }
          for (int p = 0; p < count; ++p) slope[axis * plan.particles + block + p] = columns[axis][p];
        }
      });
}

// Kernels of one scalar type by the constants that they are compiled for; `of` is null where there is none.
template <class T>
struct ScatterOf {
  using Kernel = ScatterKernel;
  static constexpr bool kWrites = true;
  template <int D, int W, int ORDER>
  static constexpr Kernel of() {
    return [](const Plan& plan, const void* position, const void* const* rows, const int32_t* index, int64_t begin,
              int64_t end, void* nodal) {
      const T* at = static_cast<const T*>(position);
      T* to = static_cast<T*>(nodal);
#if defined(__AVX512F__)
      if constexpr (sizeof(T) == sizeof(float)) {
        if constexpr (W == kGroup) {
          scatter_runs<D, ORDER>(plan, at, rows, index, begin, end, to);
        } else if (ORDER == 1 && order_of_first(plan) == 0) {
          scatter_runs<D, 0, ORDER>(plan, at, rows, index, begin, end, to);
        } else {
          scatter_runs<D, ORDER, ORDER>(plan, at, rows, index, begin, end, to);
        }
        return;
      }
#endif
      scatter<T, D, W, ORDER>(plan, at, rows, index, begin, end, to);
    };
  }
};

template <class T>
struct GatherOf {
  using Kernel = GatherKernel;
  static constexpr bool kWrites = false;
  template <int D, int W, int ORDER>
  static constexpr Kernel of() {
    return [](const Plan& plan, const void* position, const void* nodal, int64_t begin, int64_t end, void* rows) {
      gather<T, D, W, ORDER, row_of<T, W, ORDER>()>(
          plan, static_cast<const T*>(position), static_cast<const T*>(nodal), begin, end, static_cast<T*>(rows));
    };
  }
};

template <class T>
struct ContractOf {
  using Kernel = ContractKernel;
  static constexpr bool kWrites = false;
  template <int D, int W, int ORDER>
  static constexpr Kernel of() {
    if constexpr (ORDER == 0) {
      return nullptr;  // the weights have one order more than the terms
    } else {
      return [](const Plan& plan, const void* position, const void* nodal, const void* const* rows, int64_t begin,
                int64_t end, void* slope, void* gathered) {
        contract<T, D, W, ORDER, row_of<T, W, ORDER>()>(
            plan, static_cast<const T*>(position), static_cast<const T*>(nodal), rows, begin, end,
            static_cast<T*>(slope), static_cast<T*>(gathered));
      };
    }
  }
};

template <class Of, int D, int W>
typename Of::Kernel of_order(const Plan& plan) {
  switch (plan.order) {
    case 0: return Of::template of<D, W, 0>();
    case 1: return Of::template of<D, W, 1>();
    case 2: return Of::template of<D, W, 2>();
    default: return nullptr;
  }
}

// A kernel that reads nodes has a width of 1 too.
template <class Of, int D>
typename Of::Kernel of_width(const Plan& plan) {
  if (plan.stride > plan.width) return nullptr;
  if constexpr (!Of::kWrites) {
    if (plan.stride == 1) return of_order<Of, D, 1>(plan);
  }
  switch (plan.width) {
    case 4: return of_order<Of, D, 4>(plan);
    case 8: return of_order<Of, D, 8>(plan);
    default: return nullptr;
  }
}

// The kernel for the plan's dimension, width and order, or null where there is none.
template <class Of>
typename Of::Kernel chosen(const Plan& plan) {
  switch (plan.dimension) {
    case 1: return of_width<Of, 1>(plan);
    case 2: return of_width<Of, 2>(plan);
    case 3: return of_width<Of, 3>(plan);
    default: return nullptr;
  }
}

template <class T>
void slabs(const Plan& plan, const void* position, int64_t begin, int64_t end, uint8_t* slab) {
  const Axes<T> axes(plan);
  const T per_slab = 1 / T(plan.slab);
  alignas(64) T cells[kBlock], base[kBlock];
  for (int64_t from = begin; from < end; from += kBlock) {
    const Block block(nullptr, from, end);
    locate(axes, 0, Positions<T, 1>(axes, static_cast<const T*>(position), block).of[0], cells, base);
    for (int p = 0; p < block.count; ++p) slab[from + p] = static_cast<uint8_t>((static_cast<int32_t>(base[p]) + T(0.5)) * per_slab);
  }
}

template <class T, int D>
void lowest_nodes(const Plan& plan, const T* position, int32_t* column, int32_t* level) {
  const Axes<T> axes(plan);
  alignas(64) T cells[kBlock], base[kBlock];
  for (int64_t from = 0; from < plan.particles; from += kBlock) {
    const Block block(nullptr, from, plan.particles);
    const Positions<T, D> at(axes, position, block);
    alignas(64) int32_t number[kBlock] = {};
    for (int axis = 0; axis < D; ++axis) {
      locate(axes, axis, at.of[axis], cells, base);
      if (axis < D - 1) {
        for (int p = 0; p < kBlock; ++p) number[p] = number[p] * axes.nodes[axis] + static_cast<int32_t>(base[p]);
      }
    }
    for (int p = 0; p < block.count; ++p) {
      column[from + p] = number[p];
      level[from + p] = static_cast<int32_t>(base[p]);
    }
  }
}

template <class T>
void lowest(const Plan& plan, const void* position, int32_t* column, int32_t* level) {
  const T* at = static_cast<const T*>(position);
  if (plan.dimension == 2) lowest_nodes<T, 2>(plan, at, column, level);
  else lowest_nodes<T, 3>(plan, at, column, level);
}

}  // namespace

#define JAXMPM_JOIN_OF(a, b) a##_##b
#define JAXMPM_JOIN(a, b) JAXMPM_JOIN_OF(a, b)

using Number = JAXMPM_SCALAR;
extern const Kernels JAXMPM_JOIN(JAXMPM_ISA, JAXMPM_SCALAR) = {
    chosen<ScatterOf<Number>>, chosen<GatherOf<Number>>, chosen<ContractOf<Number>>, slabs<Number>, lowest<Number>};

}  // namespace jaxmpm
