// What the kernels for CPU and GPU have in common: how derivatives are numbered, a plan's numbers, the shape functions.
// Included by kernels.cc and cuda_kernels.h, within their namespaces, for the reason that kernels.h gives. A function that
// runs on either processor is JAXMPM_BOTH, what stands apart on the host JAXMPM_APART.

JAXMPM_NUMBER int jets(int dimension, int order) {
  return order == 0 ? 1 : order == 1 ? 1 + dimension : 1 + dimension + dimension * (dimension + 1) / 2;
}

// The jet that is `jet` derived once more along `axis`.
template <int D>
JAXMPM_NUMBER int derived(int jet, int axis) {
  if (jet == 0) return 1 + axis;
  const int i = jet - 1 < axis ? jet - 1 : axis, j = jet - 1 < axis ? axis : jet - 1;
  return 1 + D + i * D - i * (i - 1) / 2 + j - i;
}

// The order of derivative that `jet` of D axes takes along `axis`.
template <int D>
JAXMPM_NUMBER int order_along(int jet, int axis) {
  if (jet == 0) return 0;
  if (jet <= D) return jet - 1 == axis;
  int of_two = jet - D - 1;
  for (int i = 0; i < D; ++i) {
    for (int j = i; j < D; ++j, --of_two) {
      if (of_two == 0) return (i == axis) + (j == axis);
    }
  }
  return 0;
}

// A plan's numbers in the kernel's precision.
template <class T>
struct Axes {
  ShapeFunction function;
  int64_t particles;
  T cell, per_cell;
  bool exact;  // a product with `per_cell` rounds as a quotient does: the cell is a power of two
  T origin[kAxes], highest[kAxes], half[kAxes], per_half[kAxes];
  int32_t nodes[kAxes];

  JAXMPM_APART explicit Axes(const Plan& plan)
      : function(plan.function), particles(plan.particles), cell(T(plan.cell)), per_cell(T(1 / plan.cell)) {
    int exponent;
    exact = __builtin_frexp(plan.cell, &exponent) == 0.5;
    for (int axis = 0; axis < kAxes; ++axis) {
      origin[axis] = T(plan.origin[axis]);
      highest[axis] = T(plan.shape[axis] - kStencil);
      half[axis] = T(plan.half[axis]);
      per_half[axis] = 1 / half[axis];
      nodes[axis] = plan.shape[axis];
    }
  }
};

// Value and derivatives at distance r (in cells) of a shape function; zero for NaN. See jaxmpm/transfer/_shape.py.
template <class T, int ORDER>
JAXMPM_BOTH void shape(ShapeFunction function, T l, T per_l, T r, T* value, T* slope, T* curvature) {
  const T a = r < 0 ? -r : r;
  const T sign = r < 0 ? T(1) : T(-1);
  if (function == kLinear) {
    const bool support = (r >= -1) & (r < 1);
    *value = support ? 1 - a : T(0);
    if (ORDER > 0) *slope = support ? sign : T(0);
    if (ORDER > 1) *curvature = 0;
  } else if (function == kGimp) {
    const T reach = 1 + l - a;
    const T tail = reach > 0 ? reach : T(0);
    const bool core = a < l, flank = a < 1 - l;
    *value = core ? 1 - (r * r + l * l) * (T(0.5) * per_l) : flank ? 1 - a : tail * tail * (T(0.25) * per_l);
    if (ORDER > 0) *slope = core ? -r * per_l : flank ? sign : sign * tail * (T(0.5) * per_l);
    if (ORDER > 1) *curvature = core ? -per_l : flank | !(reach > 0) ? T(0) : T(0.5) * per_l;
  } else {
    const T reach = T(1.5) - a;
    const T tail = reach > 0 ? reach : T(0);
    const bool core = a < T(0.5);
    *value = core ? T(0.75) - r * r : tail * tail / 2;
    if (ORDER > 0) *slope = core ? -2 * r : sign * tail;
    if (ORDER > 1) *curvature = core ? T(-2) : reach > 0 ? T(1) : T(0);
  }
}
