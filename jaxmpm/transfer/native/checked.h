// What an XLA FFI handler is given, checked once: of CPU and GPU alike. Included by the unit of the handlers, once in a library.
#pragma once

#include <string>
#include <vector>

#include "kernels.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace jaxmpm {
namespace {

using Integers = ffi::Span<const int64_t>;
using Reals = ffi::Span<const double>;

ffi::Error invalid(const std::string& what) { return ffi::Error(ffi::ErrorCode::kInvalidArgument, "jaxmpm: " + what); }

// What a handler is told of the transfer; `terms` holds (row, channel, jet, factor) one after the other.
struct Attributes {
  Integers shape;
  Reals origin;
  double cell;
  int64_t function;
  Reals half;
  Integers terms;
  int64_t stored = 0;  // nodes, near soil alone; 0 for all
};

// The plan behind a handler's arrays and attributes, made piece by piece. Each piece checks what it takes, and returns
// what is wrong with it or nothing.
struct Checked {
  Plan plan{};
  std::vector<Term> terms;
  Scalar scalar = Scalar::kFloat;

  std::string take_grid(const Attributes& given) {
    plan.dimension = static_cast<int32_t>(given.shape.size());
    if (plan.dimension < 1 || plan.dimension > kAxes || given.origin.size() != given.shape.size() ||
        given.half.size() != given.shape.size()) {
      return "shape, origin and half size differ in dimension, or it is not 1 to 3";
    }
    for (int axis = 0; axis < plan.dimension; ++axis) {
      if (given.shape[axis] < kStencil || given.shape[axis] >= INT32_MAX) {
        return "an axis of the grid has fewer than 3 nodes, or more than 2^31";
      }
      plan.shape[axis] = static_cast<int32_t>(given.shape[axis]);
      plan.origin[axis] = given.origin[axis];
      plan.half[axis] = given.half[axis];
      if (nodes() > INT32_MAX) return "the grid has more than 2^31 nodes";
    }
    plan.nodes = given.stored ? given.stored : nodes();
    if (given.stored && (plan.dimension < 2 || plan.nodes < kStencil || plan.nodes > INT32_MAX)) {
      return "nodes near soil are fewer than 3, more than 2^31, or of one dimension";
    }
    plan.cell = given.cell;
    return plan.cell > 0 ? "" : "the cell is not above 0";
  }

  std::string take_function(int64_t function) {
    if (function < kLinear || function > kQuadraticBSpline) return "no shape function has this number";
    plan.function = static_cast<ShapeFunction>(function);
    for (int axis = 0; axis < plan.dimension; ++axis) {
      if (plan.function == kGimp && !(plan.half[axis] > 0 && plan.half[axis] <= 0.5 + 1e-6)) {
        return "the half size of a GIMP particle is not above 0, or exceeds half a cell";
      }
    }
    return "";
  }

  std::string take_position_and_nodal(ffi::AnyBuffer position, ffi::AnyBuffer nodal) {
    const auto type = position.element_type();
    const auto at = position.dimensions(), node = nodal.dimensions();
    const std::size_t rank = at.size();
    if ((type != ffi::F32 && type != ffi::F64) || nodal.element_type() != type || rank < 2 || node.size() != rank) {
      return "arrays must have one rank and all be float32 or all float64";
    }
    scalar = type == ffi::F32 ? Scalar::kFloat : Scalar::kDouble;
    if (at[rank - 2] != plan.dimension) return "position and grid differ in dimension";
    if (at[rank - 1] > INT32_MAX) return "there are more than 2^31 particles";
    if (node[rank - 2] != plan.nodes) return "the nodal array has not as many nodes as the grid";
    plan.particles = at[rank - 1];
    plan.stride = static_cast<int32_t>(node[rank - 1]);
    return "";
  }

  // Rows of the particle array, or arrays of `count` rows each that a kernel writes.
  std::string check_rows(ffi::AnyBuffer block, ffi::AnyBuffer position) const {
    const auto of = block.dimensions(), at = position.dimensions();
    const bool alike = block.element_type() == position.element_type() && of.size() == at.size();
    return alike && of[of.size() - 1] == plan.particles ? "" : "arrays differ in type, rank or number of particles";
  }

  std::string take_rows(const std::vector<ffi::AnyBuffer>& blocks, ffi::AnyBuffer position) {
    for (const ffi::AnyBuffer& block : blocks) {
      if (const std::string wrong = check_rows(block, position); !wrong.empty()) return wrong;
      const auto of = block.dimensions();
      plan.rows += static_cast<int32_t>(of[of.size() - 2]);
    }
    return "";
  }

  std::string take_terms(Integers numbers) {
    if (numbers.size() % 4 != 0) return "a term is not four numbers";
    const int jets[] = {1, 1 + plan.dimension, 1 + plan.dimension + plan.dimension * (plan.dimension + 1) / 2};
    std::vector<bool> met_row(plan.rows), met_node(kMaxChannels * jets[2]);
    for (std::size_t t = 0; t < numbers.size(); t += 4) {
      const int64_t row = numbers[t], channel = numbers[t + 1], jet = numbers[t + 2];
      if (row < 0 || row >= plan.rows || channel < 0 || channel >= kMaxChannels || channel >= plan.stride || jet < 0 ||
          jet >= jets[2]) {
        return "a term names a row, channel or derivative that does not exist";
      }
      while (jet >= jets[plan.order]) ++plan.order;
      if (channel >= plan.channels) plan.channels = static_cast<int32_t>(channel) + 1;
      terms.push_back({static_cast<int32_t>(row), static_cast<int32_t>(channel), static_cast<int32_t>(jet),
                       !met_node[jet * kMaxChannels + channel], !met_row[row], static_cast<double>(numbers[t + 3])});
      met_row[row] = met_node[jet * kMaxChannels + channel] = true;
    }
    plan.width = padded(plan.channels);
    plan.terms = terms.data();
    plan.term_count = static_cast<int32_t>(terms.size());
    return "";
  }

  int64_t nodes() const {
    int64_t product = 1;
    for (int axis = 0; axis < plan.dimension && plan.shape[axis] > 0; ++axis) product *= plan.shape[axis];
    return product;
  }
};

std::string check(Checked& c, const Attributes& given, ffi::AnyBuffer position, ffi::AnyBuffer nodal,
                  const std::vector<ffi::AnyBuffer>& blocks) {
  std::string wrong = c.take_grid(given);
  if (wrong.empty()) wrong = c.take_function(given.function);
  if (wrong.empty()) wrong = c.take_position_and_nodal(position, nodal);
  if (wrong.empty()) wrong = c.take_rows(blocks, position);
  if (wrong.empty()) wrong = c.take_terms(given.terms);
  return wrong;
}

// What is wrong with the leading axes of arrays that a batch of lanes reads: each is the batch's, or 1.
std::string check_lanes(const std::vector<ffi::AnyBuffer>& read, ffi::AnyBuffer::Dimensions batch) {
  for (const ffi::AnyBuffer& buffer : read) {
    const auto of = buffer.dimensions();
    if (of.size() != batch.size()) return "arrays differ in rank";
    for (std::size_t axis = 0; axis + 2 < batch.size(); ++axis) {
      if (of[axis] != 1 && of[axis] != batch[axis]) return "the leading axes of an array are not those of the batch";
    }
  }
  return "";
}

// What is wrong with the rows of columns, an array with the leading axes of a position.
std::string check_first(const Plan& plan, ffi::AnyBuffer first, ffi::AnyBuffer position) {
  const auto of = first.dimensions(), at = position.dimensions();
  int64_t columns = 1;
  for (int axis = 0; axis + 1 < plan.dimension; ++axis) columns *= plan.shape[axis];
  const bool fits = first.element_type() == ffi::S32 && of.size() == at.size() && of.size() >= 2;
  return fits && of[of.size() - 2] == 1 && of[of.size() - 1] == columns ? "" : "there is not one row for each column";
}

// What a transfer takes after its positions, and its nodes where it reads them: `first`, if `stored`, and blocks of rows.
struct Rest {
  std::vector<ffi::AnyBuffer> first, blocks;

  Rest(const std::vector<ffi::AnyBuffer>& given, int64_t stored) {
    const std::size_t count = stored && !given.empty() ? 1 : 0;
    first.assign(given.begin(), given.begin() + count);
    blocks.assign(given.begin() + count, given.end());
  }

  std::string check(const Plan& plan, int64_t stored, ffi::AnyBuffer position, ffi::AnyBuffer::Dimensions batch) const {
    if (stored && first.empty()) return "the rows of columns are missing";
    std::string wrong = stored ? check_first(plan, first[0], position) : "";
    if (wrong.empty()) wrong = check_lanes(first, batch);
    return wrong.empty() ? check_lanes(blocks, batch) : wrong;
  }
};

// The arrays that a handler takes as its last arguments.
ffi::ErrorOr<std::vector<ffi::AnyBuffer>> remaining(ffi::RemainingArgs& rest) {
  std::vector<ffi::AnyBuffer> blocks;
  for (std::size_t i = 0; i < rest.size(); ++i) {
    const auto block = rest.get<ffi::AnyBuffer>(i);
    if (!block.has_value()) return ffi::Unexpected(block.error());
    blocks.push_back(*block);
  }
  return blocks;
}

template <class Binding>
auto with_attributes(Binding binding) {
  return std::move(binding)
      .template Attr<Integers>("shape")
      .template Attr<Reals>("origin")
      .template Attr<double>("cell")
      .template Attr<int64_t>("function")
      .template Attr<Reals>("half")
      .template Attr<Integers>("terms")
      .template Attr<int64_t>("stored");
}

}  // namespace
}  // namespace jaxmpm
