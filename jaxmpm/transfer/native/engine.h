// Transfers of a batch of lanes on a pool of threads.
#pragma once

#include <cstddef>
#include <vector>

#include "kernels.h"
#include "parallel.h"

namespace jaxmpm {

// The arrays of one lane; lanes may share what they read. `rows` points to each row of the particle array.
struct ScatterLane {
  const void* position;
  const int32_t* first;  // as of `Plan`
  std::vector<const void*> rows;
  void* nodal;
};
struct GatherLane {
  const void* position;
  const int32_t* first;
  const void* nodal;
  void* rows;
};

struct ContractLane {
  const void* position;
  const int32_t* first;
  const void* nodal;
  std::vector<const void*> rows;
  void* slope;
  void* gathered;  // or null
};

// `first` and `node` as of jaxmpm/grid.py, `needed` one number.
struct NearLane {
  const void* position;
  int32_t* first;
  int32_t* node;
  int32_t* needed;
};

struct InstructionSet {
  const char* name;
  bool (*runs)();  // on this machine
  const Kernels &of_float, &of_double;
};

// The sets of the library that this machine runs, the best one last, and that one: null where there is none.
std::vector<const InstructionSet*> runnable_instructions();
const InstructionSet* best_instructions();

// Each transfer returns false, and writes nothing, where no kernel was compiled for the plan.

// Particles to nodes. `plan.stride` equals `plan.width`; every element of `nodal` is written.
[[nodiscard]] bool scatter(const InstructionSet&, const Pool&, Scalar, const Plan&, const std::vector<ScatterLane>&);

// Nodes to particles. Every element of `rows` is written.
[[nodiscard]] bool gather(const InstructionSet&, const Pool&, Scalar, const Plan&, const std::vector<GatherLane>&);

// Derivative along the position of rows times what they meet at the nodes, and that itself. Every
// element of `slope` and `gathered` is written.
[[nodiscard]] bool contract(const InstructionSet&, const Pool&, Scalar, const Plan&, const std::vector<ContractLane>&);

// The nodes near soil, `plan.nodes` of which are stored, in two or three dimensions.
void near_nodes(const InstructionSet&, const Pool&, Scalar, const Plan&, const std::vector<NearLane>&);

}  // namespace jaxmpm
