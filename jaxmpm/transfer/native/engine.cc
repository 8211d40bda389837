// How a lane's particles are shared among threads, such that the result does not depend on their number.
//
// Nodes are cut into slabs of planes across the first axis. A particle belongs to the slab of its lowest node, and
// writes to that slab and to the next two planes at most, so that every second slab can be worked on at once: first
// the even ones, then the odd ones, each particle list in ascending order. The cut depends on grid and number of
// particles alone. A stable counting sort in fixed chunks makes the lists.

#include "engine.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "instructions.h"

namespace jaxmpm {
namespace {

constexpr int64_t kChunk = 4096;      // particles per item of the sort and of the gather
constexpr int64_t kFewest = 4096;     // a lane with fewer particles is one slab
constexpr int32_t kThinnest = 2;      // planes in a slab: with fewer, slabs of equal parity would share nodes
constexpr int32_t kMostSlabs = 32;

std::size_t size_of(Scalar scalar) { return scalar == Scalar::kFloat ? sizeof(float) : sizeof(double); }

const Kernels& kernels_of(const InstructionSet& set, Scalar scalar) {
  return scalar == Scalar::kFloat ? set.of_float : set.of_double;
}

void* at(void* base, int64_t element, Scalar scalar) {
  return static_cast<char*>(base) + element * static_cast<int64_t>(size_of(scalar));
}

int64_t chunks(int64_t particles) { return (particles + kChunk - 1) / kChunk; }

// The plan of a lane.
template <class Lane>
Plan plan_of(Plan plan, const Lane& lane) {
  plan.first = lane.first;
  return plan;
}

// Calls `f(lane, begin, end)` for every chunk of particles of every lane.
template <class Lane, class F>
void over_chunks(const Pool& pool, const Plan& plan, const std::vector<Lane>& lanes, F f) {
  const int64_t parts = chunks(plan.particles), items = static_cast<int64_t>(lanes.size()) * parts;
  run_phases(pool, {{items, [&](int64_t item) {
    const int64_t begin = item % parts * kChunk;
    f(lanes[item / parts], begin, std::min(begin + kChunk, plan.particles));
  }}});
}

void clear_rows_without_terms(const Plan& plan, Scalar scalar, int64_t begin, int64_t end, void* rows) {
  for (int64_t row = 0; row < plan.rows; ++row) {
    bool met = false;
    for (int32_t t = 0; t < plan.term_count; ++t) met |= plan.terms[t].row == row;
    if (!met) std::memset(at(rows, row * plan.particles + begin, scalar), 0, (end - begin) * size_of(scalar));
  }
}

// Particle lists of the scatter that a thread runs, kept for its next ones: fresh memory costs more than to fill it.
struct Lists {
  std::vector<uint8_t> slab_of;
  std::vector<int32_t> list;
};
thread_local Lists lists;

// The phases of one lane's scatter, one at a time on a thread.
class Scatter {
 public:
  Scatter(ScatterKernel kernel, SlabsKernel slabs_kernel, Scalar scalar, const Plan& plan, const ScatterLane& lane)
      : kernel_(kernel), slabs_kernel_(slabs_kernel), scalar_(scalar), plan_(plan), lane_(lane) {
    plan_.slab = plan.shape[0];
    if (plan.particles >= kFewest) {
      plan_.slab = std::max(kThinnest, (plan.shape[0] + kMostSlabs - 1) / kMostSlabs);
    }
    slabs_ = (plan.shape[0] + plan_.slab - 1) / plan_.slab;
    plan_ = plan_of(plan_, lane);
    if (slabs_ > 1) {
      if (lists.list.size() < static_cast<std::size_t>(plan.particles)) {
        lists.slab_of.resize(plan.particles);
        lists.list.resize(plan.particles);
      }
      slab_of_ = lists.slab_of.data();
      list_ = lists.list.data();
      starts_.resize(chunks(plan.particles));
    }
  }

  std::vector<Phase> phases() {
    if (slabs_ == 1) {
      return {{1, [this](int64_t) {
                 clear(0);
                 kernel_(plan_, lane_.position, lane_.rows.data(), nullptr, 0, plan_.particles, lane_.nodal);
               }}};
    }
    const int64_t parts = chunks(plan_.particles);
    return {{parts + slabs_, [this, parts](int64_t i) { i < parts ? count(i) : clear(i - parts); }},
            {1, [this](int64_t) { order(); }},
            {parts, [this](int64_t i) { list(i); }},
            {(slabs_ + 1) / 2, [this](int64_t i) { spread(2 * i); }},
            {slabs_ / 2, [this](int64_t i) { spread(2 * i + 1); }}};
  }

 private:
  using Starts = std::array<int32_t, kMostSlabs>;

  // One of as many parts of the nodes as there are slabs.
  void clear(int64_t part) {
    const int64_t from = plan_.nodes * part / slabs_, to = plan_.nodes * (part + 1) / slabs_;
    std::memset(at(lane_.nodal, from * plan_.stride, scalar_), 0, (to - from) * plan_.stride * size_of(scalar_));
  }

  void count(int64_t chunk) {
    const int64_t begin = chunk * kChunk, end = std::min(begin + kChunk, plan_.particles);
    slabs_kernel_(plan_, lane_.position, begin, end, slab_of_);
    Starts& counts = starts_[chunk];
    counts.fill(0);
    for (int64_t p = begin; p < end;) {
      const uint8_t slab = slab_of_[p];
      const int64_t run = p;
      while (p < end && slab_of_[p] == slab) ++p;
      counts[slab] += static_cast<int32_t>(p - run);
    }
  }

  // Turns counts into the places where each chunk's particles of each slab start in the list.
  void order() {
    int32_t place = 0;
    for (int64_t slab = 0; slab < slabs_; ++slab) {
      first_[slab] = place;
      for (Starts& chunk : starts_) {
        const int32_t here = chunk[slab];
        chunk[slab] = place;
        place += here;
      }
    }
    first_[slabs_] = place;
  }

  void list(int64_t chunk) {
    const int64_t begin = chunk * kChunk, end = std::min(begin + kChunk, plan_.particles);
    Starts& starts = starts_[chunk];
    for (int64_t p = begin; p < end;) {
      const uint8_t slab = slab_of_[p];
      int32_t place = starts[slab];
      for (; p < end && slab_of_[p] == slab; ++p) list_[place++] = static_cast<int32_t>(p);
      starts[slab] = place;
    }
  }

  void spread(int64_t slab) {
    kernel_(plan_, lane_.position, lane_.rows.data(), list_, first_[slab], first_[slab + 1], lane_.nodal);
  }

  ScatterKernel kernel_;
  SlabsKernel slabs_kernel_;
  Scalar scalar_;
  Plan plan_;
  const ScatterLane& lane_;
  int64_t slabs_;
  uint8_t* slab_of_ = nullptr;
  int32_t* list_ = nullptr;
  std::vector<Starts> starts_;
  std::array<int32_t, kMostSlabs + 1> first_;
};

// Columns along the last axis whose nodes lie near soil. Kept for the next call, as `Lists`.
struct Near {
  std::vector<int32_t> column, level, low, high, before;
};
thread_local Near near_;

// Gives each entry the least of itself and the two `step` before it.
void reach(std::vector<int32_t>& of, std::vector<int32_t>& before, int64_t outer, int64_t nodes, int64_t step) {
  before = of;
  for (int64_t o = 0; o < outer; ++o) {
    int32_t* const to = of.data() + o * nodes * step;
    const int32_t* const from = before.data() + o * nodes * step;
    for (int64_t back = step; back < kStencil * step && back < nodes * step; back += step) {
      for (int64_t i = back; i < nodes * step; ++i) to[i] = std::min(to[i], from[i - back]);
    }
  }
}

void near_of_lane(const Kernels& kernels, const Plan& plan, const NearLane& lane) {
  const int32_t levels = plan.shape[plan.dimension - 1];
  const int64_t across = plan.dimension == 3 ? plan.shape[1] : 1, columns = plan.shape[0] * across;
  Near& n = near_;
  n.column.resize(plan.particles);
  n.level.resize(plan.particles);
  kernels.lowest(plan, lane.position, n.column.data(), n.level.data());
  n.low.assign(columns, levels);
  n.high.assign(columns, levels);  // negative, so that the least of it is the highest
  for (int64_t p = 0; p < plan.particles; ++p) {
    const int32_t c = n.column[p], level = n.level[p];
    n.low[c] = std::min(n.low[c], level);
    n.high[c] = std::min(n.high[c], -level);
  }
  for (std::vector<int32_t>* of : {&n.low, &n.high}) {
    reach(*of, n.before, 1, plan.shape[0], across);
    if (plan.dimension == 3) reach(*of, n.before, plan.shape[0], across, 1);
  }
  int64_t row = 0;
  for (int64_t c = 0; c < columns; ++c) {
    const bool reached = n.low[c] < levels;
    // One more than particles reach, as far as there is one.
    const int64_t height = reached ? std::min(kStencil + 1 - n.high[c], levels) - n.low[c] : 0;
    lane.first[c] = static_cast<int32_t>(row - (reached ? n.low[c] : 0));
    const int64_t node = c * levels + n.low[c], end = std::min(row + height, plan.nodes);
    for (int64_t r = row; r < end; ++r) lane.node[r] = static_cast<int32_t>(node + r - row);
    row += height;
  }
  std::fill(lane.node + std::min(row, plan.nodes), lane.node + plan.nodes, -1);
  *lane.needed = static_cast<int32_t>(row);
}

}  // namespace

void near_nodes(const InstructionSet& set, const Pool& pool, Scalar scalar, const Plan& plan,
                const std::vector<NearLane>& lanes) {
  run_phases(pool, {{static_cast<int64_t>(lanes.size()),
                     [&](int64_t i) { near_of_lane(kernels_of(set, scalar), plan, lanes[i]); }}});
}

// The sets that the library was built with, the best one last.
#define JAXMPM_DECLARE(set) extern const Kernels set##_float, set##_double
#define JAXMPM_SET(set) {#set, runs_##set, set##_float, set##_double}
#ifdef JAXMPM_PORTABLE
JAXMPM_DECLARE(portable);
#endif
#ifdef JAXMPM_AVX2
JAXMPM_DECLARE(avx2);
#endif
#ifdef JAXMPM_AVX512
JAXMPM_DECLARE(avx512);
#endif

std::vector<const InstructionSet*> runnable_instructions() {
  static const InstructionSet built[] = {
#ifdef JAXMPM_PORTABLE
      JAXMPM_SET(portable),
#endif
#ifdef JAXMPM_AVX2
      JAXMPM_SET(avx2),
#endif
#ifdef JAXMPM_AVX512
      JAXMPM_SET(avx512),
#endif
  };
  std::vector<const InstructionSet*> sets;
  for (const InstructionSet& set : built) {
    if (set.runs()) sets.push_back(&set);
  }
  return sets;
}

const InstructionSet* best_instructions() {
  static const auto sets = runnable_instructions();
  return sets.empty() ? nullptr : sets.back();
}

bool scatter(const InstructionSet& set, const Pool& pool, Scalar scalar, const Plan& plan,
             const std::vector<ScatterLane>& lanes) {
  const Kernels& kernels = kernels_of(set, scalar);
  const ScatterKernel kernel = kernels.scatter(plan);
  if (!kernel) return false;
  const auto run = [&](const Pool& on, const ScatterLane& lane) {
    Scatter work(kernel, kernels.slabs, scalar, plan, lane);
    run_phases(on, work.phases());
  };
  const int64_t count = static_cast<int64_t>(lanes.size());
  if (count >= pool.threads) {
    run_phases(pool, {{count, [&](int64_t i) { run(Pool{}, lanes[i]); }}});
  } else {
    for (const ScatterLane& lane : lanes) run(pool, lane);
  }
  return true;
}

bool gather(const InstructionSet& set, const Pool& pool, Scalar scalar, const Plan& plan,
            const std::vector<GatherLane>& lanes) {
  const GatherKernel kernel = kernels_of(set, scalar).gather(plan);
  if (!kernel) return false;
  over_chunks(pool, plan, lanes, [&](const GatherLane& lane, int64_t begin, int64_t end) {
    clear_rows_without_terms(plan, scalar, begin, end, lane.rows);
    kernel(plan_of(plan, lane), lane.position, lane.nodal, begin, end, lane.rows);
  });
  return true;
}

bool contract(const InstructionSet& set, const Pool& pool, Scalar scalar, const Plan& plan,
              const std::vector<ContractLane>& lanes) {
  const ContractKernel kernel = kernels_of(set, scalar).contract(plan);
  if (!kernel) return false;
  over_chunks(pool, plan, lanes, [&](const ContractLane& lane, int64_t begin, int64_t end) {
    if (lane.gathered) clear_rows_without_terms(plan, scalar, begin, end, lane.gathered);
    kernel(plan_of(plan, lane), lane.position, lane.nodal, lane.rows.data(), begin, end, lane.slope, lane.gathered);
  });
  return true;
}

}  // namespace jaxmpm
