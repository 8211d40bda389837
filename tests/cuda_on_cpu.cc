// The scheduler of cuda_on_cpu.h.
#include "cuda_on_cpu.h"

Index threadIdx, blockIdx, blockDim;

namespace cuda_on_cpu {

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
    for (int warp = 0; warp < threads; warp += kWarp) {
      for (bool going = true; going;) {
        going = false;
        for (b.now = warp; b.now < std::min(warp + kWarp, threads); ++b.now) {
          Fiber& fiber = *b.fibers[b.now];
          if (fiber.done || fiber.at_block) continue;
          threadIdx.x = static_cast<unsigned>(b.now);
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

void run(unsigned blocks, int threads, const std::function<void()>& work) {
  static std::mutex one_at_a_time;
  const std::lock_guard<std::mutex> hold(one_at_a_time);
  blockDim.x = static_cast<unsigned>(threads);
  for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x) run_block(threads, work);
}

}  // namespace cuda_on_cpu
