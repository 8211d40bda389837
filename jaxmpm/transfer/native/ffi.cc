// The engine as XLA FFI handlers: arrays and attributes in, checked once, lanes found among leading batch axes.

#include <algorithm>
#include <string>
#include <vector>

#include "cells.h"
#include "checked.h"
#include "engine.h"

namespace jaxmpm {
namespace {

int64_t bytes_of(ffi::AnyBuffer buffer) { return buffer.element_type() == ffi::F64 ? 8 : 4; }

// Each lane's array in a buffer whose leading axes are those of the batch, or 1 where lanes share it.
std::vector<char*> lane_starts(ffi::AnyBuffer buffer, ffi::AnyBuffer::Dimensions batch) {
  const auto of = buffer.dimensions();
  int64_t step = bytes_of(buffer) * of[of.size() - 2] * of[of.size() - 1];
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

ffi::Error answer(bool done) {
  return done ? ffi::Error::Success() : invalid("no kernel was compiled for these channels and derivatives");
}

Pool pool_of(ffi::ThreadPool& threads) {
  return {std::max<int64_t>(threads.num_threads(), 1),
          [&threads](std::function<void()> task) { threads.Schedule(std::move(task)); }};
}

// Adds pointers to every row of the blocks to each lane's.
template <class Lane>
void add_rows(const std::vector<ffi::AnyBuffer>& blocks, ffi::AnyBuffer::Dimensions batch, std::vector<Lane>& lanes) {
  for (const ffi::AnyBuffer& block : blocks) {
    const auto starts = lane_starts(block, batch);
    const auto of = block.dimensions();
    const int64_t row_bytes = bytes_of(block) * of[of.size() - 1];
    for (std::size_t i = 0; i < lanes.size(); ++i) {
      for (int64_t row = 0; row < of[of.size() - 2]; ++row) lanes[i].rows.push_back(starts[i] + row * row_bytes);
    }
  }
}

// Each lane's rows of columns, null where all nodes are stored.
std::vector<const int32_t*> firsts_of(const Rest& rest, ffi::AnyBuffer::Dimensions batch, std::size_t lanes) {
  std::vector<const int32_t*> found(lanes, nullptr);
  if (rest.first.empty()) return found;
  const auto starts = lane_starts(rest.first[0], batch);
  for (std::size_t i = 0; i < lanes; ++i) found[i] = static_cast<const int32_t*>(static_cast<const void*>(starts[i]));
  return found;
}

ffi::Error scatter_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::RemainingArgs others,
                           ffi::Result<ffi::AnyBuffer> nodal, Integers shape, Reals origin, double cell, int64_t function,
                           Reals half, Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, *nodal, rest.blocks);
  const auto batch = nodal->dimensions();
  if (wrong.empty()) wrong = check_lanes({position}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  if (wrong.empty() && c.plan.stride != c.plan.width) wrong = "the nodal array is not padded to the kernels' width";
  if (!wrong.empty()) return invalid(wrong);
  const auto positions = lane_starts(position, batch), nodals = lane_starts(*nodal, batch);
  const auto firsts = firsts_of(rest, batch, positions.size());
  std::vector<ScatterLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) lanes[i] = {positions[i], firsts[i], {}, nodals[i]};
  add_rows(rest.blocks, batch, lanes);
  return answer(scatter(*best_instructions(), pool_of(threads), c.scalar, c.plan, lanes));
}

ffi::Error gather_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::AnyBuffer nodal,
                          ffi::RemainingArgs others, ffi::Result<ffi::AnyBuffer> rows, Integers shape, Reals origin,
                          double cell, int64_t function, Reals half, Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, nodal, {*rows});
  const auto batch = rows->dimensions();
  if (wrong.empty()) wrong = check_lanes({position, nodal}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  if (wrong.empty() && !rest.blocks.empty()) wrong = "a gather takes no rows";
  if (!wrong.empty()) return invalid(wrong);
  const auto positions = lane_starts(position, batch), nodals = lane_starts(nodal, batch), out = lane_starts(*rows, batch);
  const auto firsts = firsts_of(rest, batch, positions.size());
  std::vector<GatherLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) lanes[i] = {positions[i], firsts[i], nodals[i], out[i]};
  return answer(gather(*best_instructions(), pool_of(threads), c.scalar, c.plan, lanes));
}

ffi::Error contract_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::AnyBuffer nodal,
                            ffi::RemainingArgs others, ffi::Result<ffi::AnyBuffer> slope,
                            ffi::Result<ffi::AnyBuffer> gathered, Integers shape, Reals origin, double cell,
                            int64_t function, Reals half, Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, nodal, rest.blocks);
  if (wrong.empty()) wrong = c.check_rows(*slope, position);
  if (wrong.empty()) wrong = c.check_rows(*gathered, position);
  const auto batch = slope->dimensions();
  if (wrong.empty()) wrong = check_lanes({position, nodal, *gathered}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  if (!wrong.empty()) return invalid(wrong);
  const int64_t asked = gathered->dimensions()[batch.size() - 2];
  if (batch[batch.size() - 2] != c.plan.dimension) return invalid("the slope has not one row for each axis");
  if (asked != 0 && asked != c.plan.rows) return invalid("the gathered rows are not as many as the rows given");
  ++c.plan.order;
  const auto positions = lane_starts(position, batch), nodals = lane_starts(nodal, batch);
  const auto slopes = lane_starts(*slope, batch), rows = lane_starts(*gathered, batch);
  const auto firsts = firsts_of(rest, batch, positions.size());
  std::vector<ContractLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) {
    lanes[i] = {positions[i], firsts[i], nodals[i], {}, slopes[i], asked ? rows[i] : nullptr};
  }
  add_rows(rest.blocks, batch, lanes);
  return answer(contract(*best_instructions(), pool_of(threads), c.scalar, c.plan, lanes));
}

ffi::Error near_handler(ffi::ThreadPool threads, ffi::AnyBuffer position, ffi::Result<ffi::AnyBuffer> first,
                        ffi::Result<ffi::AnyBuffer> node, ffi::Result<ffi::AnyBuffer> needed, Integers shape, Reals origin,
                        double cell) {
  const auto at = position.dimensions(), batch = node->dimensions(), one = needed->dimensions();
  const std::size_t rank = at.size();
  if (rank < 2 || batch.size() != rank || one.size() != rank || batch[rank - 2] != 1 || one[rank - 1] != 1 || one[rank - 2] != 1) {
    return invalid("arrays differ in rank, or are not one row");
  }
  Checked c;
  std::string wrong = c.take_grid({shape, origin, cell, kLinear, origin, {}, batch[rank - 1]});
  if (wrong.empty()) wrong = check_first(c.plan, *first, position);
  if (wrong.empty()) wrong = check_lanes({position, *first, *needed}, batch);
  const auto type = position.element_type();
  if (wrong.empty() && ((type != ffi::F32 && type != ffi::F64) || at[rank - 2] != c.plan.dimension ||
                        node->element_type() != ffi::S32 || needed->element_type() != ffi::S32)) {
    wrong = "positions are of another dimension or type, or numbers no int32";
  }
  if (wrong.empty() && (c.nodes() > INT32_MAX || at[rank - 1] > INT32_MAX)) wrong = "there are more than 2^31 nodes or particles";
  if (!wrong.empty()) return invalid(wrong);
  c.plan.particles = at[rank - 1];
  const auto positions = lane_starts(position, batch);
  const auto numbers = [&](ffi::AnyBuffer buffer, std::size_t lane) {
    return static_cast<int32_t*>(static_cast<void*>(lane_starts(buffer, batch)[lane]));
  };
  std::vector<NearLane> lanes(positions.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) lanes[i] = {positions[i], numbers(*first, i), numbers(*node, i), numbers(*needed, i)};
  near_nodes(*best_instructions(), pool_of(threads), type == ffi::F32 ? Scalar::kFloat : Scalar::kDouble, c.plan, lanes);
  return ffi::Error::Success();
}

template <class T>
ffi::Error cell_sums_of(const Pool& pool, ffi::AnyBuffer cell, ffi::AnyBuffer values, ffi::AnyBuffer sums, int64_t cells) {
  const auto batch = sums.dimensions();
  const auto numbers = lane_starts(cell, batch), given = lane_starts(values, batch), out = lane_starts(sums, batch);
  std::vector<CellLane<T>> lanes(out.size());
  for (std::size_t i = 0; i < lanes.size(); ++i) {
    lanes[i] = {reinterpret_cast<const int32_t*>(numbers[i]), reinterpret_cast<const T*>(given[i]),
                reinterpret_cast<T*>(out[i])};
  }
  sum_in_cells(pool, batch[batch.size() - 2], cells, batch[batch.size() - 1], lanes);
  return ffi::Error::Success();
}

ffi::Error cell_sums_handler(ffi::ThreadPool threads, ffi::AnyBuffer cell, ffi::AnyBuffer values,
                             ffi::Result<ffi::AnyBuffer> sums, int64_t cells) {
  const auto type = values.element_type();
  const auto at = cell.dimensions(), of = values.dimensions(), batch = sums->dimensions();
  const std::size_t rank = batch.size();
  if (cell.element_type() != ffi::S32 || (type != ffi::F32 && type != ffi::F64) || sums->element_type() != type) {
    return invalid("cells must be int32, values and sums both float32 or both float64");
  }
  if (rank < 2 || at.size() != rank || of.size() != rank) return invalid("arrays differ in rank");
  if (at[rank - 2] != 1 || of[rank - 2] != batch[rank - 2] || at[rank - 1] != batch[rank - 1] ||
      of[rank - 1] != batch[rank - 1]) {
    return invalid("cells, values and sums differ in their number of particles or rows");
  }
  if (cells < 1) return invalid("there is no cell");
  if (const std::string wrong = check_lanes({cell, values}, batch); !wrong.empty()) return invalid(wrong);
  const Pool pool = pool_of(threads);
  if (type == ffi::F32) return cell_sums_of<float>(pool, cell, values, *sums, cells);
  return cell_sums_of<double>(pool, cell, values, *sums, cells);
}

auto scatter_binding() {
  return with_attributes(
      ffi::Ffi::Bind().Ctx<ffi::ThreadPool>().Arg<ffi::AnyBuffer>().RemainingArgs().Ret<ffi::AnyBuffer>());
}

auto gather_binding() {
  return with_attributes(ffi::Ffi::Bind()
                             .Ctx<ffi::ThreadPool>()
                             .Arg<ffi::AnyBuffer>()
                             .Arg<ffi::AnyBuffer>()
                             .RemainingArgs()
                             .Ret<ffi::AnyBuffer>());
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

auto near_binding() {
  return ffi::Ffi::Bind()
      .Ctx<ffi::ThreadPool>()
      .Arg<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Attr<Integers>("shape")
      .Attr<Reals>("origin")
      .Attr<double>("cell");
}

auto cell_sums_binding() {
  return ffi::Ffi::Bind()
      .Ctx<ffi::ThreadPool>()
      .Arg<ffi::AnyBuffer>()
      .Arg<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Attr<int64_t>("cells");
}

}  // namespace
}  // namespace jaxmpm

#pragma GCC visibility push(default)
// Name of the instruction set that the handlers run on; null where this machine runs none of the library's, and they may not
// be called.
extern "C" const char* jaxmpm_instructions() {
  const jaxmpm::InstructionSet* best = jaxmpm::best_instructions();
  return best ? best->name : nullptr;
}
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_scatter, jaxmpm::scatter_handler, jaxmpm::scatter_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_gather, jaxmpm::gather_handler, jaxmpm::gather_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_contract, jaxmpm::contract_handler, jaxmpm::contract_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_near, jaxmpm::near_handler, jaxmpm::near_binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cell_sums, jaxmpm::cell_sums_handler, jaxmpm::cell_sums_binding());
#pragma GCC visibility pop
