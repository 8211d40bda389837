// Phases of independent items, worked on by the calling thread and by helpers from a pool that may never come.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

namespace jaxmpm {

// Threads to be had, the caller's included, and how to run a task on another one.
struct Pool {
  int64_t threads = 1;
  std::function<void(std::function<void()>)> schedule;
};

struct Phase {
  int64_t items;
  std::function<void(int64_t)> run;
};

class Work {
 public:
  explicit Work(std::vector<Phase> phases) : phases_(std::move(phases)), progress_(phases_.size()) {}

  // Takes items of each phase until none is left, and goes on once all of them are done. Only items that a running
  // thread has taken are waited for, so this ends whatever the pool does.
  void run() {
    for (std::size_t phase = 0; phase < phases_.size(); ++phase) {
      Progress& progress = progress_[phase];
      const int64_t items = phases_[phase].items;
      for (int64_t i; (i = progress.taken.fetch_add(1)) < items;) {
        phases_[phase].run(i);
        progress.done.fetch_add(1, std::memory_order_release);
      }
      for (int turns = 0; progress.done.load(std::memory_order_acquire) < items; ++turns) {
        if (turns > 1000) std::this_thread::yield();
      }
    }
  }

 private:
  struct Progress {
    alignas(64) std::atomic<int64_t> taken{0};
    alignas(64) std::atomic<int64_t> done{0};
  };
  std::vector<Phase> phases_;
  std::vector<Progress> progress_;
};

// Runs the phases one after the other, the items of each in any order and on any thread.
inline void run_phases(const Pool& pool, std::vector<Phase> phases) {
  int64_t most = 0;
  for (const Phase& phase : phases) most = phase.items > most ? phase.items : most;
  const int64_t helpers = (pool.threads < most ? pool.threads : most) - 1;
  if (helpers < 1) {
    for (const Phase& phase : phases) {
      for (int64_t i = 0; i < phase.items; ++i) phase.run(i);
    }
    return;
  }
  // A helper may start after the caller has returned: it finds no item left, and keeps the counters alive.
  const auto work = std::make_shared<Work>(std::move(phases));
  for (int64_t i = 0; i < helpers; ++i) pool.schedule([work] { work->run(); });
  work->run();
}

}  // namespace jaxmpm
