// The scheduler of cuda_on_cpu.h.
#include "cuda_on_cpu.h"

#include <numeric>
#include <random>
#include <unordered_set>
#if defined(__SSE__)
#include <xmmintrin.h>
#endif

Index threadIdx, blockIdx, blockDim;

namespace cuda_on_cpu {

namespace {

std::mt19937 chance;
bool in_turn = true;
int64_t faults = 0;
std::unordered_set<const void*> met;  // summed into, by the launch under way

// Numbers from `first` on, in the order in which they take turns.
std::vector<int> turns(int first, int count) {
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), first);
  if (!in_turn) std::shuffle(order.begin(), order.end(), chance);
  return order;
}

// XLA has its threads take subnormal numbers as 0; a GPU does so where it adds to memory alone.
struct Subnormals {
#if defined(__SSE__)
  unsigned before = _mm_getcsr();
  Subnormals() { _mm_setcsr(before & ~0x8040u); }
  ~Subnormals() { _mm_setcsr(before); }
#endif
};

}  // namespace

void note_sum(const void* at) { faults += !met.insert(at).second; }

void run_block(int threads, const std::function<void()>& work) {
  Block& b = block();
  b.work = &work;
  while (static_cast<int>(b.fibers.size()) < threads) b.fibers.push_back(std::make_unique<Fiber>());
  for (int i = 0; i < threads; ++i) {
    Fiber& fiber = *b.fibers[i];
    fiber.done = fiber.at_block = false;
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack.get();
    fiber.context.uc_stack.ss_size = kStack;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, enter, 0);
  }
  for (bool left = true; left;) {
    left = false;
    b.any = false;
    for (const int warp : turns(0, (threads + kWarp - 1) / kWarp)) {
      for (bool going = true; going;) {
        going = false;
        for (const int thread : turns(warp * kWarp, std::min(kWarp, threads - warp * kWarp))) {
          Fiber& fiber = *b.fibers[b.now = thread];
          if (fiber.done || fiber.at_block) continue;
          threadIdx.x = static_cast<unsigned>(thread);
          swapcontext(&b.scheduler, &fiber.context);
          going |= !fiber.done && !fiber.at_block;
        }
      }
    }
    b.any_before = b.any;
    for (int i = 0; i < threads; ++i) {
      left |= b.fibers[i]->at_block;
      b.fibers[i]->at_block = false;
    }
  }
}

void run(unsigned blocks, int threads, int64_t shared, const std::function<void()>& work) {
  static std::mutex one_at_a_time;
  const std::lock_guard<std::mutex> hold(one_at_a_time);
  const Subnormals kept;
  faults += blocks < 1 || threads < 1 || threads > kMostThreads || shared > kMostShared;
  blockDim.x = static_cast<unsigned>(threads);
  for (const int number : turns(0, static_cast<int>(blocks))) {
    blockIdx.x = static_cast<unsigned>(number);
    run_block(threads, work);
  }
  met.clear();
}

}  // namespace cuda_on_cpu

// From now on blocks, warps of a block and threads of a warp take turns by chance, again in their order with a seed of 0.
extern "C" void cuda_on_cpu_shuffle(unsigned seed) {
  cuda_on_cpu::chance.seed(seed);
  cuda_on_cpu::in_turn = seed == 0;
}
// Launches that a GPU refuses, and numbers to which one launch added twice, since the last call: their sum is that of chance.
extern "C" int64_t cuda_on_cpu_faults() { return std::exchange(cuda_on_cpu::faults, 0); }
