// Positions of a block of particles on the grid, and their weights. Included by kernels.cc, within its namespace.

JAXMPM_INLINE float floor_of(float x) { return __builtin_floorf(x); }
JAXMPM_INLINE double floor_of(double x) { return __builtin_floor(x); }

// Greater and lesser of two numbers; the second where one is NaN. GCC compares and selects with AVX-512.
template <class V>
JAXMPM_INLINE V greater(V a, V b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && sizeof(a[0]) == 4) return _mm512_max_ps(a, b);
  else if constexpr (sizeof(V) == 64) return _mm512_max_pd(a, b);
#endif
  return a > b ? a : b;
}
template <class V>
JAXMPM_INLINE V lesser(V a, V b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && sizeof(a[0]) == 4) return _mm512_min_ps(a, b);
  else if constexpr (sizeof(V) == 64) return _mm512_min_pd(a, b);
#endif
  return a < b ? a : b;
}

template <class V>
JAXMPM_INLINE bool differ(V a, V b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && sizeof(a[0]) == 4) return _mm512_cmp_ps_mask(a, b, _CMP_NEQ_UQ);
  else if constexpr (sizeof(V) == 64) return _mm512_cmp_pd_mask(a, b, _CMP_NEQ_UQ);
#endif
  const auto apart = a != b;
  int any = 0;
  for (unsigned i = 0; i < sizeof(V) / sizeof(a[0]); ++i) any |= apart[i] != 0;
  return any;
}

// A machine vector of particles, read and written from arrays that are aligned to it.
template <class T>
constexpr int kAtOnce = kVectorBytes / sizeof(T);
template <class T>
using Particles = typename Vector<T, kAtOnce<T>>::Type;
template <class T>
JAXMPM_INLINE Particles<T> particles_at(const T* from) {
  return *static_cast<const Particles<T>*>(static_cast<const void*>(from));
}
template <class T>
JAXMPM_INLINE Particles<T> all(T value) {
  return Particles<T>{} + value;
}

// The particles of a block: `count` that follow each other from `first` on, or those in a list.
struct Block {
  int count;
  int32_t first;
  const int32_t* list;  // or null

  Block(const int32_t* index, int64_t begin, int64_t end) {
    count = end - begin < kBlock ? static_cast<int>(end - begin) : kBlock;
    first = index ? index[begin] : static_cast<int32_t>(begin);
    list = index && index[begin + count - 1] - first != count - 1 ? index + begin : nullptr;
  }
};

// The block's numbers of a row; beyond `count` they have no meaning.
template <class T>
JAXMPM_INLINE void read(const T* row, const Block& block, T* to) {
  if (block.list) {
    for (int p = 0; p < block.count; ++p) to[p] = row[block.list[p]];
  } else if (block.count == kBlock) {
    __builtin_memcpy(to, row + block.first, kBlock * sizeof(T));
  } else {
    for (int p = 0; p < block.count; ++p) to[p] = row[block.first + p];
  }
}

// Weights of a block of particles: per axis and stencil node the value and its derivatives (1/m, 1/m2).
template <class T, int D, int ORDER>
struct Weights {
  alignas(64) T of[D][kStencil][ORDER + 1][kBlock];
  alignas(64) int32_t node[kBlock];  // lowest node of the stencil
};

template <class T, int ORDER, ShapeFunction F>
JAXMPM_INLINE void axis_weights(T l, T per_l, T per_cell, const T* cells, const T* base, T (*of)[ORDER + 1][kBlock]) {
  for (int k = 0; k < kStencil; ++k) {
    for (int p = 0; p < kBlock; ++p) {
      T slope = 0, curvature = 0;
      shape<T, ORDER>(F, l, per_l, cells[p] - (base[p] + k), &of[k][0][p], &slope, &curvature);
      if constexpr (ORDER > 0) of[k][1][p] = slope * per_cell;
      if constexpr (ORDER > 1) of[k][2][p] = curvature * per_cell * per_cell;
    }
  }
}

// `shape` of GIMP at the three nodes of stencils that lie on the grid. A particle is 1/2 to 3/2 cells above the lowest
// one, so that it is on the flank or the tail of both outer functions: u^2 / (4 l) + (t - u), where t is its distance
// from the end of the tail, and u the part of it along the tail, at most 2 l. The three weights add up to 1.
template <class T, int ORDER>
JAXMPM_INLINE void gimp_weights(T l, T per_l, T per_cell, const T* cells, const T* base, T (*of)[ORDER + 1][kBlock]) {
  using V = Particles<T>;
  const T bend = T(0.25) * per_l, steep = T(0.5) * per_l * per_cell, curved = steep * per_cell, tail = 2 * l;
  const auto put = [](T* to, V value) { *static_cast<V*>(static_cast<void*>(to)) = value; };
  for (int p = 0; p < kBlock; p += kAtOnce<T>) {
    const V r = particles_at(cells + p) - particles_at(base + p);
    const V below = (1 + l) - r, above = r - (1 - l);
    const V low = greater(below, V{}), high = greater(above, V{});
    const V low_tail = lesser(low, all(tail)), high_tail = lesser(high, all(tail));
    const V first = low_tail * low_tail * bend + (low - low_tail), last = high_tail * high_tail * bend + (high - high_tail);
    put(&of[0][0][p], first);
    put(&of[1][0][p], 1 - first - last);
    put(&of[2][0][p], last);
    if constexpr (ORDER > 0) {
      put(&of[0][1][p], low_tail * -steep);
      put(&of[1][1][p], (low_tail - high_tail) * steep);
      put(&of[2][1][p], high_tail * steep);
    }
    if constexpr (ORDER > 1) {
      const V lowest = (below > 0) & (below <= tail) ? all(curved) : V{};
      const V highest = (above >= 0) & (above < tail) ? all(curved) : V{};
      put(&of[0][2][p], lowest);
      put(&of[1][2][p], -(lowest + highest));
      put(&of[2][2][p], highest);
    }
  }
}

// Positions of a block of particles, its last places filled up with the first one's. Apart from what computes with them,
// since a load of what has just been stored piece by piece waits.
template <class T, int D>
struct Positions {
  alignas(64) T of[D][kBlock];

  JAXMPM_APART Positions(const Axes<T>& axes, const T* position, const Block& block) {
    for (int axis = 0; axis < D; ++axis) {
      read(position + axis * axes.particles, block, of[axis]);
      for (int p = block.count; p < kBlock; ++p) of[axis][p] = of[axis][0];
    }
  }
};

// Coordinates (in cells) of a block of particles along an axis and their lowest nodes, on the grid whatever the position.
// Returns whether all stencils lie on the grid without that.
template <class T>
JAXMPM_INLINE bool locate(const Axes<T>& axes, int axis, const T (&at)[kBlock], T* cells, T* base) {
  using V = Particles<T>;
  alignas(64) T lowest[kBlock];
  const T origin = axes.origin[axis];
  if (axes.exact) {
    for (int p = 0; p < kBlock; ++p) cells[p] = (at[p] - origin) * axes.per_cell;
  } else {
    for (int p = 0; p < kBlock; ++p) cells[p] = (at[p] - origin) / axes.cell;
  }
  for (int p = 0; p < kBlock; ++p) lowest[p] = floor_of(cells[p] - T(0.5));
  bool on_grid = true;
  for (int p = 0; p < kBlock; p += kAtOnce<T>) {
    const V free = particles_at(lowest + p), held = lesser(greater(free, V{}), all(axes.highest[axis]));
    *static_cast<V*>(static_cast<void*>(base + p)) = held;
    on_grid &= !differ(held, free);
  }
  return on_grid;
}

// Weights of a block of particles along an axis; `node` goes from the lowest node over the axes before to that over this one too.
template <class T, int ORDER>
JAXMPM_APART void fill_axis(const Axes<T>& axes, int axis, const T (&at)[kBlock], T (&of)[kStencil][ORDER + 1][kBlock],
                            int32_t (&node)[kBlock]) {
  alignas(64) T cells[kBlock], base[kBlock];
  const bool on_grid = locate(axes, axis, at, cells, base);
  for (int p = 0; p < kBlock; ++p) node[p] = node[p] * axes.nodes[axis] + static_cast<int32_t>(base[p]);
  const T l = axes.half[axis], per_l = axes.per_half[axis], per_cell = axes.per_cell;
  if (axes.function == kLinear) {
    axis_weights<T, ORDER, kLinear>(l, per_l, per_cell, cells, base, of);
  } else if (axes.function == kGimp && on_grid) {
    gimp_weights<T, ORDER>(l, per_l, per_cell, cells, base, of);
  } else if (axes.function == kGimp) {
    axis_weights<T, ORDER, kGimp>(l, per_l, per_cell, cells, base, of);
  } else {
    axis_weights<T, ORDER, kQuadraticBSpline>(l, per_l, per_cell, cells, base, of);
  }
}

template <class T, int D, int ORDER>
JAXMPM_INLINE void fill_weights(const Axes<T>& axes, const Positions<T, D>& at, Weights<T, D, ORDER>& w) {
  for (int p = 0; p < kBlock; ++p) w.node[p] = 0;
  for (int axis = 0; axis < D; ++axis) fill_axis<T, ORDER>(axes, axis, at.of[axis], w.of[axis], w.node);
}
