// Sums over the particles that lie in the same cell.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "parallel.h"

namespace jaxmpm {

// The arrays of one lane: the number of each particle's cell (N), its values and their sums (rows, N).
template <class T>
struct CellLane {
  const int32_t* cell;
  const T* values;
  T* sums;
};

// Gives each particle the sum of every row over the particles of its cell, in their order. `ROWS` are added together.
template <int ROWS, class T>
void sum_rows(const CellLane<T>& lane, int64_t row, int64_t cells, int64_t particles) {
  static thread_local std::vector<T> held;  // kept for the next call: fresh memory costs more than to clear it
  held.assign(ROWS * cells, T(0));
  const auto sums_of = [&](int64_t p) { return held.data() + ROWS * std::clamp<int64_t>(lane.cell[p], 0, cells - 1); };
  for (int64_t p = 0; p < particles; ++p) {
    T* const at = sums_of(p);
    for (int r = 0; r < ROWS; ++r) at[r] += lane.values[(row + r) * particles + p];
  }
  for (int64_t p = 0; p < particles; ++p) {
    const T* const at = sums_of(p);
    for (int r = 0; r < ROWS; ++r) lane.sums[(row + r) * particles + p] = at[r];
  }
}

// Lanes run side by side. One lane is summed by one thread, so that its sums do not depend on their number.
template <class T>
void sum_in_cells(const Pool& pool, int64_t rows, int64_t cells, int64_t particles, const std::vector<CellLane<T>>& lanes) {
  run_phases(pool, {{static_cast<int64_t>(lanes.size()), [&](int64_t i) {
    int64_t row = 0;
    for (; row + 2 <= rows; row += 2) sum_rows<2>(lanes[i], row, cells, particles);
    if (row < rows) sum_rows<1>(lanes[i], row, cells, particles);
  }}});
}

}  // namespace jaxmpm
