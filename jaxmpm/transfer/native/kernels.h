// What the transfer kernels are given, and the table of kernels that each unit fills.
//
// This header is compiled into translation units with different machine flags. It and kernels.cc therefore define
// no inline function with external linkage and use none of the standard library's: the linker keeps one copy of
// such a function, perhaps the one with instructions that the running machine lacks.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace jaxmpm {

enum class Scalar { kFloat, kDouble };

enum ShapeFunction : int32_t { kLinear = 0, kGimp = 1, kQuadraticBSpline = 2 };

constexpr int kAxes = 3;
constexpr int kStencil = 3;       // nodes per axis that a particle touches
constexpr int kMaxChannels = 8;   // channels of a node in one transfer
constexpr int kMaxSlabs = 64;

// Row `row` of the particle array meets channel `channel` of the nodal array through the derivative `jet` of the
// particle's weights: 0 is the weight, then d first derivatives, then the second ones by pairs of axes (0,0), (0,1) ..
// The flags tell that no earlier term has the same coefficient of a node, or the same row.
struct Term {
  int32_t row, channel, jet;
  bool first_at_node, first_at_row;
  double factor;
};

// One lane's transfer. Axes are numbered as in the arrays; the node number runs fastest along the last one.
struct Plan {
  int32_t dimension;
  int32_t shape[kAxes];
  int64_t nodes;          // that are stored
  const int32_t* first;   // of each column, the row of its lowest node less that node's number in it; null where all are stored
  double origin[kAxes];
  double cell;
  ShapeFunction function;
  double half[kAxes];     // half size of a GIMP particle in cells
  int64_t particles;
  int32_t channels;       // of the nodal array
  int32_t stride;         // from node to node: `channels`, or the padded width where the kernel writes nodes
  int32_t width;          // 4 or 8: channels worked on at once
  int32_t order;          // highest derivative among the terms: 0, 1 or 2
  int32_t rows;
  int32_t slab;           // planes of nodes across the first axis that make up a slab
  const Term* terms;
  int32_t term_count;
};

// Smallest width that the kernels have for this many channels.
static inline int32_t padded(int32_t channels) { return channels <= 4 ? 4 : 8; }

// Particle arrays are (components, particles), or one pointer per row; `index` lists particles or is null for all in their
// order; [begin, end) is a range of that list, or of particles.
using ScatterKernel = void (*)(const Plan&, const void* position, const void* const* rows, const int32_t* index,
                               int64_t begin, int64_t end, void* nodal);
using GatherKernel = void (*)(const Plan&, const void* position, const void* nodal, int64_t begin, int64_t end, void* rows);
// Derivative along the position (d, particles) of the sum of rows times what `gather` gives for them, and that itself
// unless `gathered` is null; `order` is one above that of the terms.
using ContractKernel = void (*)(const Plan&, const void* position, const void* nodal, const void* const* rows,
                                int64_t begin, int64_t end, void* slope, void* gathered);
// The slab of each particle's lowest node.
using SlabsKernel = void (*)(const Plan&, const void* position, int64_t begin, int64_t end, uint8_t* slab);

// The column of each particle's lowest node, and that node's number in the column.
using LowestKernel = void (*)(const Plan&, const void* position, int32_t* column, int32_t* level);

// Kernels of one instruction set and scalar type. The first three are chosen by a plan's dimension, width and order, and null
// for a plan that no kernel was compiled for.
struct Kernels {
  ScatterKernel (*scatter)(const Plan&);
  GatherKernel (*gather)(const Plan&);
  ContractKernel (*contract)(const Plan&);
  SlabsKernel slabs;
  LowestKernel lowest;
};

}  // namespace jaxmpm
