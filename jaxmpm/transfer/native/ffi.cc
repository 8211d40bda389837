// The engine as XLA FFI handlers: arrays and attributes in, checked once, lanes found among leading batch axes.

#include <algorithm>
#include <string>
#include <vector>

#include "engine.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace jaxmpm {
namespace {

using Integers = ffi::Span<const int64_t>;
using Reals = ffi::Span<const double>;

ffi::Error invalid(const std::string& what) { return ffi::Error(ffi::ErrorCode::kInvalidArgument, "jaxmpm: " + what); }

// Each lane's array in a buffer whose leading axes are those of the batch, or 1 where lanes share it.
std::vector<char*> lane_starts(ffi::AnyBuffer buffer, ffi::AnyBuffer::Dimensions batch) {
  const auto of = buffer.dimensions();
  const int64_t bytes = buffer.element_type() == ffi::F32 ? 4 : 8;
  int64_t step = bytes * of[of.size() - 2] * of[of.size() - 1];
  std::vector<char*> starts = {static_cast<char*>(buffer.untyped_data())};
  for (std::size_t axis = batch.size() - 2; axis-- > 0;) {
    std::vector<char*> lanes;
    for (int64_t i = 0; i < batch[axis]; ++i) {
      for (char* start : starts) lanes.push_back(start + (of[axis] == 1 ? 0 : i * step));
    }
    starts = std::move(lanes);
    step *= of[axis];
  }
  return starts;
}

struct Checked {
  Plan plan{};
  std::vector<Term> terms;
  Scalar scalar;
  std::string error;
};

// The plan behind the attributes; `terms` holds (row, channel, jet, factor) one after the other.
Checked check(ffi::AnyBuffer position, const std::vector<ffi::AnyBuffer>& blocks, ffi::AnyBuffer nodal, Integers shape, Reals origin, double cell,
              int64_t function, Reals half, Integers terms) {
  Checked c;
  const auto type = position.element_type();
  const auto at = position.dimensions(), node = nodal.dimensions();
  const std::size_t rank = at.size();
  if ((type != ffi::F32 && type != ffi::F64) || nodal.element_type() != type || rank < 2 || node.size() != rank) {
    c.error = "arrays must have one rank and all be float32 or all float64";
    return c;
  }
  c.scalar = type == ffi::F32 ? Scalar::kFloat : Scalar::kDouble;
  Plan& plan = c.plan;
  plan.dimension = static_cast<int32_t>(shape.size());
  if (plan.dimension < 1 || plan.dimension > kAxes || origin.size() != shape.size() || half.size() != shape.size() ||
      at[rank - 2] != plan.dimension) {
    c.error = "position, shape, origin and half size differ in dimension";
    return c;
  }
  int64_t nodes = 1;
  for (int axis = 0; axis < plan.dimension; ++axis) {
    if (shape[axis] < kStencil || shape[axis] >= INT32_MAX) {
      c.error = "an axis of the grid has fewer than 3 nodes";
      return c;
    }
    plan.shape[axis] = static_cast<int32_t>(shape[axis]);
    plan.origin[axis] = origin[axis];
    plan.half[axis] = half[axis];
    nodes *= shape[axis];
  }
  plan.particles = at[rank - 1];
  plan.stride = static_cast<int32_t>(node[rank - 1]);
  if (node[rank - 2] != nodes || nodes > INT32_MAX || plan.particles > INT32_MAX) {
    c.error = "the nodal array has not as many nodes as the grid, or there are more than 2^31 of them or of particles";
    return c;
  }
  for (const ffi::AnyBuffer& block : blocks) {
    const auto of = block.dimensions();
    if (block.element_type() != type || of.size() != rank || of[rank - 1] != plan.particles) {
      c.error = "arrays differ in type, rank or number of particles";
      return c;
    }
    plan.rows += static_cast<int32_t>(of[rank - 2]);
  }
  plan.cell = cell;
  plan.function = static_cast<ShapeFunction>(function);
  plan.order = 0;
  const int jets[] = {1, 1 + plan.dimension, 1 + plan.dimension + plan.dimension * (plan.dimension + 1) / 2};
  std::vector<bool> met_row(plan.rows), met_node(kMaxChannels * 10);
  for (std::size_t t = 0; t + 3 < terms.size(); t += 4) {
    const int64_t row = terms[t], channel = terms[t + 1], jet = terms[t + 2];
    if (row < 0 || row >= plan.rows || channel < 0 || channel >= kMaxChannels || channel >= plan.stride || jet < 0 ||
        jet >= jets[2]) {
      c.error = "a term names a row, channel or derivative that does not exist";
      return c;
    }
    while (jet >= jets[plan.order]) ++plan.order;
    if (channel >= plan.channels) plan.channels = static_cast<int32_t>(channel) + 1;
    c.terms.push_back({static_cast<int32_t>(row), static_cast<int32_t>(channel), static_cast<int32_t>(jet),
                       !met_node[jet * kMaxChannels + channel], !met_row[row], static_cast<double>(terms[t + 3])});
    met_row[row] = met_node[jet * kMaxChannels + channel] = true;
  }
  plan.width = padded(plan.channels);
  plan.terms = c.terms.data();
  plan.term_count = static_cast<int32_t>(c.terms.size());
  return c;
}

Pool pool_of(ffi::ThreadPool& threads) {
  return {std::max<int64_t>(threads.num_threads(), 1),
          [&threads](std::function<void()> task) { threads.Schedule(std::move(task)); }};
}

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

// Adds pointers to every row of the blocks to each lane's.
template <class Lane>
void add_rows(const std::vector<ffi::AnyBuffer>& blocks, ffi::AnyBuffer::Dimensions batch, std::vector<Lane>& lanes) {
  for (const ffi::AnyBuffer& block : blocks) {
    const auto starts = lane_starts(block, batch);
    const auto of = block.dimensions();
    const int64_t row_bytes = (block.element_type() == ffi::F32 ? 4 : 8) * of[of.size() - 1];
    for (std::size_t i = 0; i < lanes.size(); ++i) {
      for (int64_t row = 0; row < of[of.size() - 2]; ++row) lanes[i].rows.push_back(starts[i] + row * row_bytes);
    }
  }
}

ffi::Error scatter_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::RemainingArgs rest,
                           ffi::Result<ffi::AnyBuffer> nodal, Integers shape, Reals origin, double cell, int64_t function,
                           Reals half, Integers terms) {
  const auto blocks = remaining(rest);
  if (!blocks.has_value()) return blocks.error();
  const Checked c = check(position, *blocks, *nodal, shape, origin, cell, function, half, terms);
  if (!c.error.empty()) return invalid(c.error);
  if (c.plan.stride != c.plan.width) return invalid("the nodal array is not padded to the kernels' width");
  const auto batch = nodal->dimensions();
  const auto positions = lane_starts(position, batch), nodals = lane_starts(*nodal, batch);
  std::vector<ScatterLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) lanes[i] = {positions[i], {}, nodals[i]};
  add_rows(*blocks, batch, lanes);
  scatter(best_instructions(), pool_of(threads), c.scalar, c.plan, lanes);
  return ffi::Error::Success();
}

ffi::Error gather_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::AnyBuffer nodal,
                          ffi::Result<ffi::AnyBuffer> rows, Integers shape, Reals origin, double cell, int64_t function,
                          Reals half, Integers terms) {
  const Checked c = check(position, {*rows}, nodal, shape, origin, cell, function, half, terms);
  if (!c.error.empty()) return invalid(c.error);
  const auto batch = rows->dimensions();
  const auto positions = lane_starts(position, batch), nodals = lane_starts(nodal, batch), out = lane_starts(*rows, batch);
  std::vector<GatherLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) lanes[i] = {positions[i], nodals[i], out[i]};
  gather(best_instructions(), pool_of(threads), c.scalar, c.plan, lanes);
  return ffi::Error::Success();
}

ffi::Error contract_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::AnyBuffer nodal,
                            ffi::RemainingArgs rest, ffi::Result<ffi::AnyBuffer> slope,
                            ffi::Result<ffi::AnyBuffer> gathered, Integers shape, Reals origin, double cell,
                            int64_t function, Reals half, Integers terms) {
  const auto blocks = remaining(rest);
  if (!blocks.has_value()) return blocks.error();
  Checked c = check(position, *blocks, nodal, shape, origin, cell, function, half, terms);
  if (!c.error.empty()) return invalid(c.error);
  if (++c.plan.order > 2) return invalid("the kernels have no third derivatives");
  const auto batch = slope->dimensions();
  const auto positions = lane_starts(position, batch), nodals = lane_starts(nodal, batch);
  const auto slopes = lane_starts(*slope, batch), rows = lane_starts(*gathered, batch);
  const int64_t asked = gathered->dimensions()[batch.size() - 2];
  if (asked != 0 && asked != c.plan.rows) return invalid("the gathered rows are not as many as the rows given");
  std::vector<ContractLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) {
    lanes[i] = {positions[i], nodals[i], {}, slopes[i], asked ? rows[i] : nullptr};
  }
  add_rows(*blocks, batch, lanes);
  contract(best_instructions(), pool_of(threads), c.scalar, c.plan, lanes);
  return ffi::Error::Success();
}

template <class Binding>
auto with_attributes(Binding binding) {
  return std::move(binding)
      .template Attr<Integers>("shape")
      .template Attr<Reals>("origin")
      .template Attr<double>("cell")
      .template Attr<int64_t>("function")
      .template Attr<Reals>("half")
      .template Attr<Integers>("terms");
}

auto scatter_binding() {
  return with_attributes(
      ffi::Ffi::Bind().Ctx<ffi::ThreadPool>().Arg<ffi::AnyBuffer>().RemainingArgs().Ret<ffi::AnyBuffer>());
}

auto gather_binding() {
  return with_attributes(
      ffi::Ffi::Bind().Ctx<ffi::ThreadPool>().Arg<ffi::AnyBuffer>().Arg<ffi::AnyBuffer>().Ret<ffi::AnyBuffer>());
}

auto contract_binding() {
  return with_attributes(ffi::Ffi::Bind()
                             .Ctx<ffi::ThreadPool>()
                             .Arg<ffi::AnyBuffer>()
                             .Arg<ffi::AnyBuffer>()
                             .RemainingArgs()
                             .Ret<ffi::AnyBuffer>()
                             .Ret<ffi::AnyBuffer>());
}

}  // namespace
}  // namespace jaxmpm

#pragma GCC visibility push(default)
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_scatter, jaxmpm::scatter_handler, jaxmpm::scatter_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_gather, jaxmpm::gather_handler, jaxmpm::gather_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_contract, jaxmpm::contract_handler, jaxmpm::contract_binding());
#pragma GCC visibility pop
