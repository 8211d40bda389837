// Runs the native engine on cases from standard input, for a build with sanitizers: see test_native_fuzz.py.
//
// A case is a line `dimension n0 n1 n2 function half particles threads`, then the particles' coordinates (in cells,
// axis by axis) as hexadecimal floats or nan and inf. Arrays are as large as the engine is promised and no larger.
// Exit status 1 tells that threads or instruction sets disagree.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include "cells.h"
#include "engine.h"

using namespace jaxmpm;

namespace {

struct Threads {
  std::vector<std::thread> running;
  Pool pool;
  explicit Threads(int64_t count) {
    pool.threads = count;
    pool.schedule = [this](std::function<void()> task) { running.emplace_back(std::move(task)); };
  }
  ~Threads() {
    for (std::thread& thread : running) thread.join();
  }
};

// Every derivative of order up to `order` of one channel each, as far as channels go, and one row used twice.
std::vector<Term> some_terms(int dimension, int order, int channels) {
  const int jets[] = {1, 1 + dimension, 1 + dimension + dimension * (dimension + 1) / 2};
  std::vector<Term> terms;
  for (int jet = 0; jet < jets[order]; ++jet) terms.push_back({jet, jet % channels, jet, true, true, 1.0});
  terms.push_back({0, channels - 1, jets[order] - 1, jets[order] == 1 ? channels > 1 : (jets[order] - 1) % channels != channels - 1, false, -1.0});
  return terms;
}

template <class T>
bool close(const std::vector<T>& a, const std::vector<T>& b) {
  T largest = 0;
  for (T x : a) largest = std::isfinite(x) && std::abs(x) > largest ? std::abs(x) : largest;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (!(std::abs(a[i] - b[i]) <= (sizeof(T) == 4 ? 1e-4 : 1e-11) * (1 + largest))) return false;
  }
  return true;
}

// Nodes near soil, as many as `stored`, or all with 0; then the rows of columns go to `first`.
template <class T>
bool run(Plan plan, Scalar scalar, const std::vector<double>& cells, int64_t threads, int64_t stored, bool wild) {
  const std::vector<T> position(cells.begin(), cells.end());
  plan.nodes = 1;
  for (int axis = 0; axis < plan.dimension; ++axis) plan.nodes *= plan.shape[axis];
  std::vector<int32_t> of_columns(plan.nodes / plan.shape[plan.dimension - 1]), of_rows(stored);
  int32_t needed = 0;
  if (stored) {
    plan.nodes = stored;
    near_nodes(*best_instructions(), Pool{}, scalar, plan, {{position.data(), of_columns.data(), of_rows.data(), &needed}});
    for (int32_t node : of_rows) {
      if (node < -1) return false;
    }
    // Rows that were not found at these positions: no kernel leaves its arrays.
    for (std::size_t c = 0; wild && c < of_columns.size(); ++c) of_columns[c] = static_cast<int32_t>(c * 2654435761u);
  }
  const int32_t* const first = stored ? of_columns.data() : nullptr;
  // Rows that several nodes share have sums that mean nothing, to each instruction set its own.
  const bool alike = !wild && needed <= stored;
  const int64_t nodes = plan.nodes;
  bool good = true;
  for (int order = 0; order <= 2; ++order) {
    for (int channels : {1, 3, 7}) {
      const std::vector<Term> terms = some_terms(plan.dimension, order, channels);
      plan.terms = terms.data();
      plan.term_count = static_cast<int32_t>(terms.size());
      plan.order = order;
      plan.channels = channels;
      plan.width = padded(channels);
      plan.rows = static_cast<int32_t>(terms.size()) - 1;
      std::vector<T> rows(plan.rows * plan.particles), nodal(nodes * channels);
      for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = T(1 + i % 7);
      for (std::size_t i = 0; i < nodal.size(); ++i) nodal[i] = T(1 + i % 5);
      std::vector<std::vector<T>> scattered, gathered, slopes;
      for (const InstructionSet* set : runnable_instructions()) {
        for (int64_t count : {int64_t{1}, threads}) {
          Threads pool(count);
          std::vector<T> onto(nodes * plan.width, T(NAN)), from(rows.size(), T(NAN));
          plan.stride = plan.width;
          std::vector<const void*> pointers;
          for (int row = 0; row < plan.rows; ++row) pointers.push_back(rows.data() + row * plan.particles);
          bool done = scatter(*set, pool.pool, scalar, plan, {{position.data(), first, pointers, onto.data()}});
          plan.stride = channels;
          done = gather(*set, pool.pool, scalar, plan, {{position.data(), first, nodal.data(), from.data()}}) && done;
          std::vector<T> slope(plan.dimension * plan.particles, T(NAN)), again(rows.size(), T(NAN));
          if (order < 2) {
            ++plan.order;
            done = contract(*set, pool.pool, scalar, plan, {{position.data(), first, nodal.data(), pointers, slope.data(), again.data()}}) && done;
            --plan.order;
            if (!close(from, again)) {
              std::printf("%s: contract gathers otherwise than gather, order %d, %d channels\n", set->name, order, channels);
              good = false;
            }
          } else {
            slope.clear();
          }
          if (!done) {
            std::printf("%s: no kernel, order %d, %d channels\n", set->name, order, channels);
            good = false;
          }
          slopes.push_back(slope);
          scattered.push_back(onto);
          gathered.push_back(from);
        }
        const std::size_t n = scattered.size();
        const auto same = [](const std::vector<T>& a, const std::vector<T>& b) {
          return a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0;
        };
        if (!same(scattered[n - 2], scattered[n - 1]) || !same(gathered[n - 2], gathered[n - 1]) ||
            !same(slopes[n - 2], slopes[n - 1])) {
          std::printf("%s: threads disagree, order %d, %d channels\n", set->name, order, channels);
          good = false;
        }
        if (alike && !(close(scattered[0], scattered[n - 1]) && close(gathered[0], gathered[n - 1]) &&
                       close(slopes[0], slopes[n - 1]))) {
          std::printf("%s: not as portable, order %d, %d channels\n", set->name, order, channels);
          good = false;
        }
      }
    }
  }
  return good;
}

// Whether the sums within cells are those of a plain loop, for any number of threads. Numbers of cells that do not exist
// count as those of the nearest one.
template <class T>
bool sums(int64_t particles, int64_t threads) {
  const int64_t cells = 5, rows = 3;
  std::vector<int32_t> cell(particles);
  std::vector<T> values(rows * particles), right(rows * particles, T(0));
  for (int64_t p = 0; p < particles; ++p) cell[p] = static_cast<int32_t>(p * 7919 % 11 - 3);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = T(1 + i % 7);
  std::vector<T> total(rows * cells, T(0));
  const auto element = [&](int64_t row, int64_t p) { return row * cells + std::clamp<int64_t>(cell[p], 0, cells - 1); };
  for (int64_t row = 0; row < rows; ++row) {
    for (int64_t p = 0; p < particles; ++p) total[element(row, p)] += values[row * particles + p];
    for (int64_t p = 0; p < particles; ++p) right[row * particles + p] = total[element(row, p)];
  }
  for (int64_t count : {int64_t{1}, threads}) {
    std::vector<T> once(values.size(), T(NAN)), again = once;
    {
      Threads pool(count);
      sum_in_cells<T>(pool.pool, rows, cells, particles, {{cell.data(), values.data(), once.data()}, {cell.data(), values.data(), again.data()}});
    }
    if (once != right || again != right) {
      std::printf("sums within cells differ, %d particles\n", static_cast<int>(particles));
      return false;
    }
  }
  return true;
}

// Whether each transfer refuses a plan that no kernel was compiled for, and writes nothing. The plan has no particles and
// one row; a kernel that ran all the same would clear the nodes.
bool refuses(int dimension, int width, int order, int stride = 0) {
  Plan plan{};
  plan.dimension = dimension;
  plan.width = plan.channels = width;
  plan.stride = stride ? stride : width;
  plan.order = order;
  plan.rows = 1;
  plan.cell = 1;
  for (int axis = 0; axis < kAxes; ++axis) plan.shape[axis] = 3;
  std::vector<float> nodal(27 * 16, 1.0f), empty;
  bool good = true;
  for (const InstructionSet* set : runnable_instructions()) {
    const bool scattered = scatter(*set, Pool{}, Scalar::kFloat, plan, {{empty.data(), nullptr, {empty.data()}, nodal.data()}});
    const bool gathered = gather(*set, Pool{}, Scalar::kFloat, plan, {{empty.data(), nullptr, nodal.data(), empty.data()}});
    const bool contracted = contract(*set, Pool{}, Scalar::kFloat, plan,
                                     {{empty.data(), nullptr, nodal.data(), {empty.data()}, empty.data(), empty.data()}});
    bool untouched = true;
    for (float x : nodal) untouched = untouched && x == 1.0f;
    if (scattered || gathered || contracted || !untouched) {
      std::printf("%s: takes %d axes, width %d, order %d\n", set->name, dimension, width, order);
      good = false;
    }
  }
  return good;
}

}  // namespace

int main() {
  Plan plan{};
  int function, cases = 0;
  int64_t threads;
  double half;
  bool good = refuses(0, 4, 1) && refuses(4, 4, 1) && refuses(2, 5, 1) && refuses(2, 16, 1) && refuses(2, 4, 3) &&
              refuses(2, 4, -1) && refuses(2, 4, 1, 5);
  while (std::cin >> plan.dimension >> plan.shape[0] >> plan.shape[1] >> plan.shape[2] >> function >> half >> plan.particles >>
         threads) {
    plan.function = static_cast<ShapeFunction>(function);
    plan.cell = 1;
    for (int axis = 0; axis < kAxes; ++axis) plan.half[axis] = half;
    std::vector<double> cells(plan.dimension * plan.particles);
    for (double& x : cells) {
      std::string word;
      std::cin >> word;
      x = std::strtod(word.c_str(), nullptr);
    }
    for (int64_t stored : {0, 5, 400}) {
      if (stored && plan.dimension == 1) continue;
      for (bool wild : {false, true}) {
        if (wild && !stored) continue;
        // With threads wild rows would be added to at the same time.
        const int64_t count = wild || stored == 5 ? 1 : threads;
        good = run<float>(plan, Scalar::kFloat, cells, count, stored, wild) && good;
        good = run<double>(plan, Scalar::kDouble, cells, count, stored, wild) && good;
      }
    }
    good = sums<float>(plan.particles, threads) && sums<double>(plan.particles, threads) && good;
    ++cases;
  }
  std::printf("%d cases\n", cases);
  return good ? 0 : 1;
}
