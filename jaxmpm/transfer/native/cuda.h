// The engine for CUDA GPUs: what its launchers are given, and which there are.
//
// Sums are the same for any number of lanes and from run to run. Particles are put in the order of their stencils, and of
// their numbers within one. A column is all stencils with the same lowest node but along the last axis. One block of threads
// sums a column in that order, and adds it to the nodes, each node once. Columns beside each other along the last axis but
// one add to copies of the nodes of their own, which are summed in the end, and those along the axis before follow each other
// in launches of their own.
#pragma once

#include <algorithm>

#include "kernels.h"

#if defined(JAXMPM_CUDA_ON_CPU)
#include JAXMPM_CUDA_ON_CPU
#else
#include <cuda_runtime.h>
#define JAXMPM_LAUNCH(kernel, blocks, threads, bytes, stream, ...) kernel<<<blocks, threads, bytes, stream>>>(__VA_ARGS__)
#define JAXMPM_SHARED(name) extern __shared__ __align__(16) unsigned char name[]
#endif

namespace jaxmpm {

constexpr int32_t kSegments = 8;      // at most so many parts of a column are summed side by side
constexpr int kMaxJets = 10;      // derivatives of order 0 to 2 in three dimensions
constexpr int kMaxTerms = 120;
constexpr int64_t kFewNumbers = int64_t{1} << 19;  // whose copies cost less than two more launches

// The arrays of all lanes: `step` numbers from one to the next, 0 where they share it.
struct Lanes {
  void* data;
  int64_t step;
};

// Particles of all lanes in the order of the lowest nodes of their stencils, or of their cells. Those of node k of lane l are
// list[offsets[l * nodes + k]] to list[offsets[l * nodes + k + 1] - 1]. Particles that no node is near are left out.
struct Order {
  int32_t* list;
  int32_t* offsets;
  bool shared;  // by all lanes
};

// Terms in the order of derivative and channel: those of bucket b = derivative * kMaxChannels + channel are
// entry[start[b]] to entry[start[b + 1] - 1].
struct Terms {
  struct Entry {
    const void* data;  // row of the first lane, for what is read
    int32_t step;      // numbers from one lane to the next
    uint16_t row;      // of all rows, for what is written
    bool first;        // no earlier entry has the same row
    float factor;
  };
  uint16_t start[kMaxJets * kMaxChannels + 1];
  Entry entry[kMaxTerms];
};

// One transfer of all lanes. What a transfer has no use for is null.
struct Transfer {
  Plan plan;
  int64_t lanes;
  Lanes position, nodal, slope, rows;
  Lanes first;          // rows of columns, see Plan; null where all nodes are stored
  void* copies;         // of `nodal` of all lanes, copies_of() times
  Terms terms;
  Order order;
  cudaStream_t stream;
};

// How the stencils along the last axis of a grid are cut into segments.
struct Cut {
  int32_t length, count;
};
inline Cut cut_of(const Plan& plan) {
  const int32_t stencils = plan.shape[plan.dimension - 1] - kStencil + 1;
  // Short ones have few particles for all that a segment takes. One of fewer than two would share nodes with the one after
  // the next.
  const int32_t most = plan.dimension == 3 ? 24 : 32, count = std::min((stencils + most - 1) / most, kSegments);
  const int32_t length = std::max(2, (stencils + count - 1) / count);
  return {length, (stencils + length - 1) / length};
}

// Copies of the nodes, of so many numbers in all lanes, that a scatter sums into; 0 where it sums into the nodes themselves. Few
// numbers have a copy for each column that meets a node, so that one launch sums all of them: the sums are the same. Rows of
// nodes near soil do not tell which plane they lie in, by which those copies are summed.
inline int32_t copies_of(int32_t dimension, int64_t numbers, bool near) {
  return dimension == 1 ? 0 : dimension == 3 && numbers <= kFewNumbers && !near ? kStencil * kStencil : kStencil;
}

// Each returns false, and launches nothing, where no kernel was compiled for the plan.
struct CudaKernels {
  bool (*scatter)(const Transfer&);
  bool (*gather)(const Transfer&);
  bool (*contract)(const Transfer&);
};
extern const CudaKernels cuda_float, cuda_double;

// Bytes that putting so many particles in the order of so many nodes or cells takes, those of all lanes together.
int64_t bytes_to_order(int64_t particles, int64_t places);

// Fills the order of `lanes` lanes. Returns what failed, or null.
const char* put_in_order(const Plan& plan, Scalar scalar, int64_t lanes, const void* position, const Order& order,
                         void* scratch, cudaStream_t stream);

// What `sum_in_cells` in cells.h does. Returns what failed, or null.
const char* sum_in_cells(Scalar scalar, int64_t lanes, int64_t rows, int64_t particles, int64_t cells, Lanes cell,
                         Lanes values, void* sums, void* scratch, cudaStream_t stream);

// Whether the library has code for a GPU.
cudaError_t try_kernels(int device);

}  // namespace jaxmpm
