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
    nodes_ = 1;
    for (int axis = 0; axis < plan.dimension; ++axis) nodes_ *= plan.shape[axis];
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

  void clear(int64_t slab) {
    const int64_t plane = nodes_ / plan_.shape[0] * plan_.stride;
    const int64_t from = slab * plan_.slab, to = std::min<int64_t>(from + plan_.slab, plan_.shape[0]);
    std::memset(at(lane_.nodal, from * plane, scalar_), 0, (to - from) * plane * size_of(scalar_));
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
  int64_t slabs_, nodes_;
  uint8_t* slab_of_ = nullptr;
  int32_t* list_ = nullptr;
  std::vector<Starts> starts_;
  std::array<int32_t, kMostSlabs + 1> first_;
};

}  // namespace

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
    kernel(plan, lane.position, lane.nodal, begin, end, lane.rows);
  });
  return true;
}

bool contract(const InstructionSet& set, const Pool& pool, Scalar scalar, const Plan& plan,
              const std::vector<ContractLane>& lanes) {
  const ContractKernel kernel = kernels_of(set, scalar).contract(plan);
  if (!kernel) return false;
  over_chunks(pool, plan, lanes, [&](const ContractLane& lane, int64_t begin, int64_t end) {
    if (lane.gathered) clear_rows_without_terms(plan, scalar, begin, end, lane.gathered);
    kernel(plan, lane.position, lane.nodal, lane.rows.data(), begin, end, lane.slope, lane.gathered);
  });
  return true;
}

}  // namespace jaxmpm
