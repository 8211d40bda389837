// Scatter of float32 with AVX-512: particles with the same stencil that follow each other are summed in registers, and
// their sums are added to the nodes once. Included by kernels.cc, within its namespace.
//
// Channels are worked on in groups of four. The three nodes of a stencil along the last axis, four channels each, are one
// vector of which the last quarter stays empty; a stencil in three dimensions has nine such rows.

constexpr int kGroup = 4;

// Where `transpose` puts the four numbers of a particle of a block.
JAXMPM_INLINE int place_of(int p) { return (p & ~15) * kGroup + (p & 3) * 16 + (p >> 2 & 3) * kGroup; }

// A column of a block of particles, and what it is multiplied with.
struct Column {
  const float* from;
  float factor;
};

// Four columns, such that a particle's four numbers follow each other.
JAXMPM_INLINE void transpose(const Column (&columns)[kGroup], float* to) {
  const auto at = [&](int c, int p) { return _mm512_loadu_ps(columns[c].from + p) * columns[c].factor; };
  for (int p = 0; p < kBlock; p += 16) {
    const __m512 a = at(0, p), b = at(1, p), c = at(2, p), d = at(3, p);
    const __m512d ab = _mm512_castps_pd(_mm512_unpacklo_ps(a, b)), AB = _mm512_castps_pd(_mm512_unpackhi_ps(a, b));
    const __m512d cd = _mm512_castps_pd(_mm512_unpacklo_ps(c, d)), CD = _mm512_castps_pd(_mm512_unpackhi_ps(c, d));
    _mm512_store_ps(to + p * kGroup, _mm512_castpd_ps(_mm512_unpacklo_pd(ab, cd)));
    _mm512_store_ps(to + p * kGroup + 16, _mm512_castpd_ps(_mm512_unpackhi_pd(ab, cd)));
    _mm512_store_ps(to + p * kGroup + 32, _mm512_castpd_ps(_mm512_unpacklo_pd(AB, CD)));
    _mm512_store_ps(to + p * kGroup + 48, _mm512_castpd_ps(_mm512_unpackhi_pd(AB, CD)));
  }
}

// A row of nodes without its first one; the last quarter of a row is empty.
JAXMPM_INLINE __m512 without_first(__m512 a) { return _mm512_shuffle_f32x4(a, a, 0b11111001); }

// Adds the sums of one or two groups of channels to a row of three nodes.
JAXMPM_INLINE void add_row(float* node, __m512 a) {
  _mm_storeu_ps(node, _mm_add_ps(_mm_loadu_ps(node), _mm512_castps512_ps128(a)));
  _mm_storeu_ps(node + 4, _mm_add_ps(_mm_loadu_ps(node + 4), _mm512_extractf32x4_ps(a, 1)));
  _mm_storeu_ps(node + 8, _mm_add_ps(_mm_loadu_ps(node + 8), _mm512_extractf32x4_ps(a, 2)));
}
JAXMPM_INLINE void add_row(float* node, __m512 a, __m512 b) {
  const __m512i first = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), last = _mm512_setr_epi64(4, 5, 12, 13, 4, 5, 12, 13);
  const __m512d x = _mm512_castps_pd(a), y = _mm512_castps_pd(b);
  const __m512 low = _mm512_castpd_ps(_mm512_permutex2var_pd(x, first, y));
  const __m512 high = _mm512_castpd_ps(_mm512_permutex2var_pd(x, last, y));
  _mm256_storeu_ps(node, _mm256_add_ps(_mm256_loadu_ps(node), _mm512_castps512_ps256(low)));
  _mm256_storeu_ps(node + 8, _mm256_add_ps(_mm256_loadu_ps(node + 8), _mm512_extractf32x8_ps(low, 1)));
  _mm256_storeu_ps(node + 16, _mm256_add_ps(_mm256_loadu_ps(node + 16), _mm512_castps512_ps256(high)));
}

// Adds the first node of a row, and moves the sums of the two others down.
JAXMPM_INLINE void add_first(float* node, __m512& a) {
  _mm_storeu_ps(node, _mm_add_ps(_mm_loadu_ps(node), _mm512_castps512_ps128(a)));
  a = without_first(a);
}
JAXMPM_INLINE void add_first(float* node, __m512& a, __m512& b) {
  const __m256 both = _mm256_insertf128_ps(_mm512_castps512_ps256(a), _mm512_castps512_ps128(b), 1);
  _mm256_storeu_ps(node, _mm256_add_ps(_mm256_loadu_ps(node), both));
  a = without_first(a);
  b = without_first(b);
}

// Products of a block's weights over all axes but the last, by derivative and row of the stencil.
template <int D, int ORDER>
struct RowWeights {
  alignas(64) float of[jets(D - 1, ORDER)][rows_of(D)][kBlock];
};

template <int D, int ORDER>
JAXMPM_APART void fill_row_weights(const Weights<float, D, ORDER>& w, RowWeights<D, ORDER>& r) {
  for (int j = 0; j < jets(D - 1, ORDER); ++j) {
    for (int row = 0; row < rows_of(D); ++row) {
      if constexpr (D == 1) {
        for (int p = 0; p < kBlock; ++p) r.of[j][row][p] = 1;
      } else if constexpr (D == 2) {
        for (int p = 0; p < kBlock; ++p) r.of[j][row][p] = w.of[0][row][j][p];
      } else {
        const float* a = w.of[0][row / 3][order_along<2>(j, 0)];
        const float* b = w.of[1][row % 3][order_along<2>(j, 1)];
        for (int p = 0; p < kBlock; ++p) r.of[j][row][p] = a[p] * b[p];
      }
    }
  }
}

// The columns of a block, for one that is not read in place.
template <int G, int J>
JAXMPM_APART void fill_columns(const Plan& plan, const void* const* rows, const Block& block,
                                float (&columns)[G][J][kGroup][kBlock]) {
  for (int t = 0; t < plan.term_count; ++t) {
    const Term& term = plan.terms[t];
    const float* from = static_cast<const float*>(rows[term.row]) + (block.list ? 0 : block.first);
    const float factor = float(term.factor);
    float* to = columns[term.channel / kGroup][term.jet][term.channel % kGroup];
    if (!term.first_at_node) {
      for (int p = 0; p < block.count; ++p) to[p] += factor * from[block.list ? block.list[p] : p];
    } else if (block.list) {
      for (int p = 0; p < block.count; ++p) to[p] = factor * from[block.list[p]];
    } else {
      for (int p = 0; p < block.count; ++p) to[p] = factor * from[p];
    }
  }
}

// A particle's row of nodes that `jet` of the axes but the last multiplies.
template <int D, int O, int JET, int ORDER>
JAXMPM_INLINE __m512 nodes_of(const float (*coefficients)[kBlock * kGroup], int place, const __m512 (&along)[ORDER]) {
  __m512 row = _mm512_mul_ps(along[0], _mm512_broadcast_f32x4(_mm_load_ps(coefficients[extended<D>(JET, 0)] + place)));
  if constexpr (O > 0 && JET < jets(D - 1, O - 1)) {
    row = _mm512_fmadd_ps(along[1], _mm512_broadcast_f32x4(_mm_load_ps(coefficients[extended<D>(JET, 1)] + place)), row);
  }
  if constexpr (O > 1 && JET < jets(D - 1, O - 2)) {
    row = _mm512_fmadd_ps(along[2], _mm512_broadcast_f32x4(_mm_load_ps(coefficients[extended<D>(JET, 2)] + place)), row);
  }
  return row;
}

// Adds a particle's products of a group of channels to the sums of its rows.
template <int D, int O, int JET = 0, int ORDER, int R>
JAXMPM_INLINE void add_products(const float (*coefficients)[kBlock * kGroup], int place, const __m512 (&along)[ORDER],
                                const float (*across)[R][kBlock], int p, __m512 (&sums)[R]) {
  const __m512 row = nodes_of<D, O, JET>(coefficients, place, along);
#pragma GCC unroll 9
  for (int r = 0; r < R; ++r) sums[r] = _mm512_fmadd_ps(_mm512_set1_ps(across[JET][r][p]), row, sums[r]);
  if constexpr (JET + 1 < jets(D - 1, O)) add_products<D, O, JET + 1>(coefficients, place, along, across, p, sums);
}

// The sums of particles with the same stencil, as rows of nodes of G groups of channels.
template <int G, int R>
struct RowSums {
  __m512 of[G][R];

  JAXMPM_MEMBER void clear() {
#pragma GCC unroll 2
    for (int g = 0; g < G; ++g) {
#pragma GCC unroll 9
      for (int row = 0; row < R; ++row) of[g][row] = _mm512_setzero_ps();
    }
  }

  JAXMPM_MEMBER void add(float* node, const int64_t (&offsets)[R]) const {
#pragma GCC unroll 9
    for (int row = 0; row < R; ++row) {
      if constexpr (G == 1) add_row(node + offsets[row], of[0][row]);
      else add_row(node + offsets[row], of[0][row], of[1][row]);
    }
  }

  // For the stencil one node up the last axis: adds what it does not reach.
  JAXMPM_MEMBER void move_up(float* node, const int64_t (&offsets)[R]) {
#pragma GCC unroll 9
    for (int row = 0; row < R; ++row) {
      if constexpr (G == 1) add_first(node + offsets[row], of[0][row]);
      else add_first(node + offsets[row], of[0][row], of[1][row]);
    }
  }
};

// The sums of `spread`, where channels of group g meet derivatives up to order O.
template <int D, int... O>
void scatter_runs(const Plan& plan, const float* position, const void* const* rows, const int32_t* index, int64_t begin,
                  int64_t end, float* nodal) {
  constexpr int G = sizeof...(O), orders[] = {O...}, ORDER = orders[G - 1], J = jets(D, ORDER), R = rows_of(D);
  const Axes<float> axes(plan);
  const Term* alone[G][J][kGroup] = {};
  bool single = true;  // no two terms in a column
  for (int t = 0; t < plan.term_count; ++t) {
    const Term& term = plan.terms[t];
    alone[term.channel / kGroup][term.jet][term.channel % kGroup] = &term;
    single &= term.first_at_node;
  }
  NodeRows<D> node_rows(plan);
  Weights<float, D, ORDER> weights;
  RowWeights<D, ORDER> across;
  alignas(64) float columns[G][J][kGroup][kBlock] = {}, coefficients[G][J][kBlock * kGroup];
  alignas(64) float none[kBlock] = {}, last[ORDER + 1][kBlock * kGroup];
  const __m512i quarters = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
  RowSums<G, R> sums;
  sums.clear();
  int32_t base = -1;  // lowest node of the stencil that `sums` belongs to
  float* node = nodal;  // where it starts
  for (int64_t from = begin; from < end; from += kBlock) {
    const Block block(index, from, end);
    const bool in_place = single && !block.list && block.count == kBlock;
    const Positions<float, D> at(axes, position, block);
    if (!in_place) fill_columns(plan, rows, block, columns);
    fill_weights(axes, at, weights);
    fill_row_weights<D, ORDER>(weights, across);
#pragma GCC unroll 3
    for (int o = 0; o <= ORDER; ++o) {
      const auto& of = weights.of[D - 1];
      transpose({{of[0][o], 1}, {of[1][o], 1}, {of[2][o], 1}, {none, 1}}, last[o]);
    }
#pragma GCC unroll 2
    for (int g = 0; g < G; ++g) {
      for (int j = 0; j < jets(D, orders[g]); ++j) {
        Column four[kGroup];
#pragma GCC unroll 4
        for (int c = 0; c < kGroup; ++c) {
          const Term* term = in_place ? alone[g][j][c] : nullptr;
          four[c].from = term ? static_cast<const float*>(rows[term->row]) + block.first : columns[g][j][c];
          four[c].factor = term ? float(term->factor) : 1;
        }
        transpose(four, coefficients[g][j]);
      }
    }
    for (int p = 0; p < block.count; ++p) {
      if (weights.node[p] != base) {
        if (base >= 0 && weights.node[p] == base + 1) {
          sums.move_up(node, node_rows.of);
        } else {
          if (base >= 0) sums.add(node, node_rows.of);
          sums.clear();
        }
        base = weights.node[p];
        node = nodal + node_rows.start(base);
      }
      const int place = place_of(p);
      __m512 along[ORDER + 1];
#pragma GCC unroll 3
      for (int o = 0; o <= ORDER; ++o) {
        along[o] = _mm512_permutevar_ps(_mm512_broadcast_f32x4(_mm_load_ps(last[o] + place)), quarters);
      }
      add_products<D, orders[0]>(coefficients[0], place, along, across.of, p, sums.of[0]);
      if constexpr (G == 2) add_products<D, orders[1]>(coefficients[1], place, along, across.of, p, sums.of[1]);
    }
  }
  if (base >= 0) sums.add(node, node_rows.of);
}

// Highest derivative that channels of the first group meet.
JAXMPM_INLINE int order_of_first(const Plan& plan) {
  int highest = 0;
  for (int t = 0; t < plan.term_count; ++t) {
    const Term& term = plan.terms[t];
    if (term.channel < kGroup && term.jet > 0) highest = term.jet > plan.dimension ? 2 : highest > 1 ? highest : 1;
  }
  return highest;
}
