// CUDA on a CPU, as much of it as the engine for GPUs uses: a block's threads are fibers that take turns, warp by warp.
// Each runs until it meets the others of its warp or of its block. Blocks run one after the other.
#pragma once

#include <ucontext.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <mutex>
#include <type_traits>
#include <utility>
#include <vector>

#define __global__
#define __device__
#define __host__
#define __shared__ static
#define __grid_constant__
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __restrict__

using std::floor;

struct Index {
  unsigned x;
};

namespace cuda_on_cpu {

constexpr int kWarp = 32;
constexpr std::size_t kStack = 256 * 1024;
constexpr int kMostThreads = 1024;
constexpr int64_t kMostShared = 48 * 1024;  // bytes, without a word to the driver

struct Fiber {
  ucontext_t context;
  std::unique_ptr<char[]> stack{new char[kStack]};
  bool done = false, at_block = false;
};

struct Block {
  std::vector<std::unique_ptr<Fiber>> fibers;
  ucontext_t scheduler;
  int now = 0;
  bool any = false, any_before = false;
  alignas(16) unsigned char slots[1024][16];
  const std::function<void()>* work = nullptr;
};

inline Block& block() {
  static Block one;
  return one;
}

inline void yield() { swapcontext(&block().fibers[block().now]->context, &block().scheduler); }

inline void enter() {
  (*block().work)();
  block().fibers[block().now]->done = true;
  yield();
}

// What lane `from` of the warp gives; every lane of the warp has given its own by then.
template <class T>
T exchanged(T own, int from) {
  Block& b = block();
  const int me = b.now;
  std::memcpy(b.slots[me], &own, sizeof own);
  yield();
  T result;
  std::memcpy(&result, b.slots[me / kWarp * kWarp + from], sizeof result);
  yield();
  return result;
}

// As a GPU adds to its memory: subnormal floats are 0.
inline float flushed(float of) { return std::fpclassify(of) == FP_SUBNORMAL ? std::copysign(0.0f, of) : of; }
inline float added(float to, float value) { return flushed(flushed(to) + flushed(value)); }
template <class T>
T added(T to, T value) {
  return to + value;
}

void run_block(int threads, const std::function<void()>& work);
void run(unsigned blocks, int threads, int64_t shared, const std::function<void()>& work);
void note_sum(const void* at);

}  // namespace cuda_on_cpu

extern Index threadIdx, blockIdx, blockDim;

inline int lane_of_warp() { return static_cast<int>(threadIdx.x) % cuda_on_cpu::kWarp; }
template <class T>
T __shfl_sync(unsigned, T own, int from) {
  return cuda_on_cpu::exchanged(own, from);
}
template <class T>
T __shfl_up_sync(unsigned, T own, int by) {
  return cuda_on_cpu::exchanged(own, lane_of_warp() >= by ? lane_of_warp() - by : lane_of_warp());
}
template <class T>
T __shfl_down_sync(unsigned, T own, int by) {
  return cuda_on_cpu::exchanged(own, lane_of_warp() + by < cuda_on_cpu::kWarp ? lane_of_warp() + by : lane_of_warp());
}
inline unsigned __ballot_sync(unsigned, bool own) {
  cuda_on_cpu::Block& b = cuda_on_cpu::block();
  const int me = b.now, first = me / cuda_on_cpu::kWarp * cuda_on_cpu::kWarp;
  b.slots[me][0] = own;
  cuda_on_cpu::yield();
  unsigned bits = 0;
  for (int i = 0; i < cuda_on_cpu::kWarp; ++i) bits |= unsigned{b.slots[first + i][0] != 0} << i;
  cuda_on_cpu::yield();
  return bits;
}
inline void __syncwarp() { cuda_on_cpu::yield(); }
inline int __ffs(unsigned bits) { return __builtin_ffs(static_cast<int>(bits)); }
inline bool __syncthreads_or(bool own) {
  cuda_on_cpu::Block& b = cuda_on_cpu::block();
  b.any |= own;
  b.fibers[b.now]->at_block = true;
  cuda_on_cpu::yield();
  return b.any_before;
}
inline void __syncthreads() { __syncthreads_or(false); }
template <class T>
T atomicAdd(T* at, T value) {
  if (std::is_floating_point_v<T> && value != 0) cuda_on_cpu::note_sum(at);
  return std::exchange(*at, cuda_on_cpu::added(*at, value));
}

#define JAXMPM_SHARED(name) alignas(16) static unsigned char name[cuda_on_cpu::kMostShared]
#define JAXMPM_LAUNCH(kernel, blocks, threads, bytes, stream, ...) \
  cuda_on_cpu::run(blocks, threads, bytes, [&] { (void)stream; kernel(__VA_ARGS__); })

using cudaStream_t = void*;
enum cudaError_t { cudaSuccess };
struct cudaFuncAttributes {};
inline cudaError_t cudaFuncGetAttributes(cudaFuncAttributes*, const void*) { return cudaSuccess; }
inline cudaError_t cudaGetDevice(int*) { return cudaSuccess; }
inline cudaError_t cudaSetDevice(int) { return cudaSuccess; }
inline cudaError_t cudaGetLastError() { return cudaSuccess; }
inline const char* cudaGetErrorString(cudaError_t) { return ""; }
inline cudaError_t cudaMemsetAsync(void* to, int value, std::size_t bytes, cudaStream_t) {
  std::memset(to, value, bytes);
  return cudaSuccess;
}
