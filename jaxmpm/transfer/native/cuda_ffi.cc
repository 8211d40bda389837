// The engine for CUDA GPUs as XLA FFI handlers. Arrays have one leading axis, that of lanes, of length 1 where lanes share
// them.

#include <algorithm>
#include <string>
#include <vector>

#include "checked.h"
#include "cuda.h"

#if defined(JAXMPM_CUDA_ON_CPU)
struct NoStream {};
template <>
struct xla::ffi::CtxDecoding<NoStream> {
  using Type = cudaStream_t;
  static std::optional<Type> Decode(const XLA_FFI_Api*, XLA_FFI_ExecutionContext*, DiagnosticEngine&) { return cudaStream_t{}; }
};
using StreamOfCall = NoStream;
#else
using StreamOfCall = ffi::PlatformStream<cudaStream_t>;
#endif

namespace jaxmpm {
namespace {

ffi::Error failed(const char* fault) { return ffi::Error::Internal(std::string("jaxmpm: ") + fault); }

// Takes the error of this call, which the next one would take for its own.
ffi::Error answer(bool done) {
  const cudaError_t error = cudaGetLastError();
  if (error != cudaSuccess) return failed(cudaGetErrorString(error));
  return done ? ffi::Error::Success() : invalid("no kernel was compiled for these channels and derivatives");
}

ffi::Error answer(const char* fault) {
  if (!fault) return answer(true);
  cudaGetLastError();
  return failed(fault);
}

Lanes lanes_of(ffi::AnyBuffer buffer) {
  const auto of = buffer.dimensions();
  return {buffer.untyped_data(), of[0] == 1 ? 0 : of[1] * of[2]};
}

std::string check_ranks(const std::vector<ffi::AnyBuffer>& buffers) {
  for (const ffi::AnyBuffer& buffer : buffers) {
    if (buffer.dimensions().size() != 3) return "an array has not one axis of lanes and two of its own";
  }
  return "";
}

// A row of a block of rows.
struct Row {
  const char* data;
  int64_t step;
};

std::vector<Row> rows_of(const std::vector<ffi::AnyBuffer>& blocks) {
  std::vector<Row> rows;
  for (const ffi::AnyBuffer& block : blocks) {
    const auto of = block.dimensions();
    const int64_t bytes = of[2] * (block.element_type() == ffi::F64 ? 8 : 4);
    for (int64_t row = 0; row < of[1]; ++row) {
      rows.push_back({static_cast<const char*>(block.untyped_data()) + row * bytes, lanes_of(block).step});
    }
  }
  return rows;
}

// Terms in the order of their buckets, with the rows that they read or numbers of those that they write.
std::string take_terms(const Checked& c, const std::vector<Row>& rows, Terms& terms) {
  if (c.terms.size() > kMaxTerms || c.plan.rows > UINT16_MAX) return "there are more terms or rows than a kernel takes: take Engine.XLA";
  std::vector<bool> met(c.plan.rows);
  uint16_t count = 0;
  for (int bucket = 0; bucket < kMaxJets * kMaxChannels; ++bucket) {
    terms.start[bucket] = count;
    for (const Term& term : c.terms) {
      if (term.jet * kMaxChannels + term.channel != bucket) continue;
      const Row row = rows.empty() ? Row{} : rows[term.row];
      if (row.step > INT32_MAX) return "the rows of a lane have more than 2^31 numbers";
      terms.entry[count++] = {row.data, static_cast<int32_t>(row.step), static_cast<uint16_t>(term.row), !met[term.row],
                              static_cast<float>(term.factor)};
      met[term.row] = true;
    }
  }
  terms.start[kMaxJets * kMaxChannels] = count;
  return "";
}

Transfer transfer_of(const Checked& c, int64_t lanes, ffi::AnyBuffer position, ffi::AnyBuffer nodal, const Rest& rest,
                     cudaStream_t stream) {
  Transfer transfer{};
  transfer.plan = c.plan;
  transfer.lanes = lanes;
  transfer.position = lanes_of(position);
  transfer.nodal = lanes_of(nodal);
  if (!rest.first.empty()) transfer.first = lanes_of(rest.first[0]);
  transfer.stream = stream;
  return transfer;
}

// Rows that no term writes become 0.
void clear_rows_without_terms(const Checked& c, ffi::AnyBuffer rows, cudaStream_t stream) {
  std::vector<bool> met(c.plan.rows);
  for (const Term& term : c.terms) met[term.row] = true;
  if (std::find(met.begin(), met.end(), false) != met.end()) cudaMemsetAsync(rows.untyped_data(), 0, rows.size_bytes(), stream);
}

std::string check_order(const Checked& c, ffi::AnyBuffer position, ffi::AnyBuffer list, ffi::AnyBuffer offsets) {
  const auto at = position.dimensions(), of_list = list.dimensions(), of_offsets = offsets.dimensions();
  if (list.element_type() != ffi::S32 || offsets.element_type() != ffi::S32) return "an order must be of int32";
  if (of_list[0] != at[0] || of_list[1] != 1 || of_list[2] != c.plan.particles) return "the order is not one of so many particles";
  const bool fits = of_offsets[0] == 1 && of_offsets[1] == 1 && of_offsets[2] == at[0] * c.nodes() + 1;
  return fits ? "" : "the order is one for another grid";
}

std::string check_size(int64_t lanes, int64_t particles, int64_t places, ffi::AnyBuffer scratch) {
  if (lanes * particles > INT32_MAX || lanes * places >= INT32_MAX) {
    return "all lanes together have more than 2^31 particles or nodes: run fewer at once";
  }
  const bool fits = static_cast<int64_t>(scratch.size_bytes()) >= bytes_to_order(lanes * particles, lanes * places);
  return fits ? "" : "there is too little room to put particles in order";
}

ffi::Error order_handler(cudaStream_t stream, ffi::AnyBuffer position, ffi::Result<ffi::AnyBuffer> list,
                         ffi::Result<ffi::AnyBuffer> offsets, ffi::Result<ffi::AnyBuffer> scratch, Integers shape, Reals origin,
                         double cell) {
  Checked c;
  std::string wrong = check_ranks({position, *list, *offsets});
  if (wrong.empty()) wrong = c.take_grid({shape, origin, cell, kLinear, origin, {}});
  if (!wrong.empty()) return invalid(wrong);
  const auto at = position.dimensions();
  if (at[1] != c.plan.dimension) wrong = "position and grid differ in dimension";
  if (wrong.empty() && position.element_type() != ffi::F32 && position.element_type() != ffi::F64) wrong = "positions must be float32 or float64";
  if (wrong.empty()) {
    c.plan.particles = at[2];
    wrong = check_order(c, position, *list, *offsets);
  }
  if (wrong.empty()) wrong = check_size(at[0], at[2], c.nodes(), *scratch);
  if (!wrong.empty()) return invalid(wrong);
  const Order order{static_cast<int32_t*>(list->untyped_data()), static_cast<int32_t*>(offsets->untyped_data()), at[0] == 1};
  const Scalar scalar = position.element_type() == ffi::F32 ? Scalar::kFloat : Scalar::kDouble;
  return answer(put_in_order(c.plan, scalar, at[0], position.untyped_data(), order, scratch->untyped_data(), stream));
}

const CudaKernels& kernels_of(Scalar scalar) { return scalar == Scalar::kFloat ? cuda_float : cuda_double; }

ffi::Error scatter_handler(cudaStream_t stream, ffi::AnyBuffer position, ffi::AnyBuffer list, ffi::AnyBuffer offsets,
                           ffi::RemainingArgs others, ffi::Result<ffi::AnyBuffer> nodal, ffi::Result<ffi::AnyBuffer> copies,
                           Integers shape, Reals origin, double cell, int64_t function, Reals half, Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check_ranks({position, list, offsets, *nodal});
  if (wrong.empty()) wrong = check_ranks(*given);
  if (wrong.empty()) wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, *nodal, rest.blocks);
  const auto batch = nodal->dimensions();
  if (wrong.empty()) wrong = check_lanes({position}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  if (wrong.empty()) wrong = check_order(c, position, list, offsets);
  if (wrong.empty() && c.plan.stride != c.plan.width) wrong = "the nodal array is not padded to the kernels' width";
  const int64_t numbers = nodal->element_count();
  if (wrong.empty() && static_cast<int64_t>(copies->element_count()) < numbers * copies_of(c.plan.dimension, numbers, stored)) wrong = "there are too few copies of the nodes";
  if (!wrong.empty()) return invalid(wrong);
  Transfer transfer = transfer_of(c, batch[0], position, *nodal, rest, stream);
  if (wrong = take_terms(c, rows_of(rest.blocks), transfer.terms); !wrong.empty()) return invalid(wrong);
  transfer.order = {static_cast<int32_t*>(list.untyped_data()), static_cast<int32_t*>(offsets.untyped_data()), position.dimensions()[0] == 1};
  transfer.copies = copies->untyped_data();
  return answer(kernels_of(c.scalar).scatter(transfer));
}

ffi::Error gather_handler(cudaStream_t stream, ffi::AnyBuffer position, ffi::AnyBuffer nodal, ffi::RemainingArgs others,
                          ffi::Result<ffi::AnyBuffer> rows, Integers shape, Reals origin, double cell, int64_t function, Reals half,
                          Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check_ranks({position, nodal, *rows});
  if (wrong.empty()) wrong = check_ranks(*given);
  if (wrong.empty()) wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, nodal, {*rows});
  const auto batch = rows->dimensions();
  if (wrong.empty()) wrong = check_lanes({position, nodal}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  if (wrong.empty() && !rest.blocks.empty()) wrong = "a gather takes no rows";
  if (!wrong.empty()) return invalid(wrong);
  Transfer transfer = transfer_of(c, batch[0], position, nodal, rest, stream);
  transfer.rows = lanes_of(*rows);
  if (wrong = take_terms(c, {}, transfer.terms); !wrong.empty()) return invalid(wrong);
  clear_rows_without_terms(c, *rows, stream);
  return answer(kernels_of(c.scalar).gather(transfer));
}

ffi::Error contract_handler(cudaStream_t stream, ffi::AnyBuffer position, ffi::AnyBuffer nodal, ffi::RemainingArgs others,
                            ffi::Result<ffi::AnyBuffer> slope, ffi::Result<ffi::AnyBuffer> gathered, Integers shape, Reals origin,
                            double cell, int64_t function, Reals half, Integers terms, int64_t stored) {
  const auto given = remaining(others);
  if (!given.has_value()) return given.error();
  const Rest rest(*given, stored);
  Checked c;
  std::string wrong = check_ranks({position, nodal, *slope, *gathered});
  if (wrong.empty()) wrong = check_ranks(*given);
  if (wrong.empty()) wrong = check(c, {shape, origin, cell, function, half, terms, stored}, position, nodal, rest.blocks);
  if (wrong.empty()) wrong = c.check_rows(*slope, position);
  if (wrong.empty()) wrong = c.check_rows(*gathered, position);
  const auto batch = slope->dimensions();
  if (wrong.empty()) wrong = check_lanes({position, nodal, *gathered}, batch);
  if (wrong.empty()) wrong = rest.check(c.plan, stored, position, batch);
  const int64_t asked = wrong.empty() ? gathered->dimensions()[1] : 0;
  if (wrong.empty() && batch[1] != c.plan.dimension) wrong = "the slope has not one row for each axis";
  if (wrong.empty() && asked != 0 && asked != c.plan.rows) wrong = "the gathered rows are not as many as the rows given";
  if (!wrong.empty()) return invalid(wrong);
  ++c.plan.order;
  Transfer transfer = transfer_of(c, batch[0], position, nodal, rest, stream);
  transfer.slope = lanes_of(*slope);
  if (wrong = take_terms(c, rows_of(rest.blocks), transfer.terms); !wrong.empty()) return invalid(wrong);
  if (asked) {
    transfer.rows = lanes_of(*gathered);
    clear_rows_without_terms(c, *gathered, stream);
  }
  return answer(kernels_of(c.scalar).contract(transfer));
}

ffi::Error cell_sums_handler(cudaStream_t stream, ffi::AnyBuffer cell, ffi::AnyBuffer values, ffi::Result<ffi::AnyBuffer> sums,
                             ffi::Result<ffi::AnyBuffer> scratch, int64_t cells) {
  std::string wrong = check_ranks({cell, values, *sums});
  const auto type = values.element_type();
  const auto at = cell.dimensions(), of = values.dimensions(), batch = sums->dimensions();
  if (!wrong.empty()) return invalid(wrong);
  if ((cell.element_type() != ffi::S32 || (type != ffi::F32 && type != ffi::F64) || sums->element_type() != type)) {
    wrong = "cells must be int32, values and sums both float32 or both float64";
  }
  if (wrong.empty() && (at[1] != 1 || of[1] != batch[1] || at[2] != batch[2] || of[2] != batch[2])) {
    wrong = "cells, values and sums differ in their number of particles or rows";
  }
  if (wrong.empty() && (cells < 1 || cells >= INT32_MAX)) wrong = "there is no cell, or more than 2^31";
  if (wrong.empty()) wrong = check_lanes({cell, values}, batch);
  if (wrong.empty()) wrong = check_size(at[0], at[2], cells, *scratch);
  if (!wrong.empty()) return invalid(wrong);
  const Scalar scalar = type == ffi::F32 ? Scalar::kFloat : Scalar::kDouble;
  // Lanes that share cells have one order, a single lane too.
  return answer(sum_in_cells(scalar, batch[0], batch[1], at[2], cells, lanes_of(cell), lanes_of(values), sums->untyped_data(),
                             scratch->untyped_data(), stream));
}

auto on_stream() { return ffi::Ffi::Bind().Ctx<StreamOfCall>().Arg<ffi::AnyBuffer>(); }
auto order_binding() {
  return on_stream()
      .Ret<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Ret<ffi::AnyBuffer>()
      .Attr<Integers>("shape")
      .Attr<Reals>("origin")
      .Attr<double>("cell");
}
auto scatter_binding() {
  return with_attributes(on_stream().Arg<ffi::AnyBuffer>().Arg<ffi::AnyBuffer>().RemainingArgs().Ret<ffi::AnyBuffer>().Ret<ffi::AnyBuffer>());
}
auto gather_binding() {
  return with_attributes(on_stream().Arg<ffi::AnyBuffer>().RemainingArgs().Ret<ffi::AnyBuffer>());
}
auto contract_binding() {
  return with_attributes(on_stream().Arg<ffi::AnyBuffer>().RemainingArgs().Ret<ffi::AnyBuffer>().Ret<ffi::AnyBuffer>());
}
auto cell_sums_binding() {
  return on_stream().Arg<ffi::AnyBuffer>().Ret<ffi::AnyBuffer>().Ret<ffi::AnyBuffer>().Attr<int64_t>("cells");
}

}  // namespace
}  // namespace jaxmpm

#pragma GCC visibility push(default)
// Copies that a scatter takes of its nodes, of so many numbers in all lanes; near: nodes near soil alone are stored.
extern "C" int32_t jaxmpm_cuda_copies(int32_t dimension, int64_t numbers, bool near) { return jaxmpm::copies_of(dimension, numbers, near); }
// Bytes of scratch of an order or of sums in cells, for the particles and the nodes or cells of all lanes that have an order.
extern "C" int64_t jaxmpm_cuda_bytes_to_order(int64_t particles, int64_t places) { return jaxmpm::bytes_to_order(particles, places); }
// Why a GPU of this machine does not run the library; null where it does.
extern "C" const char* jaxmpm_cuda_fault(int32_t device) {
  const cudaError_t error = jaxmpm::try_kernels(device);
  return error == cudaSuccess ? nullptr : cudaGetErrorString(error);
}
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cuda_order, jaxmpm::order_handler, jaxmpm::order_binding(), {ffi::Traits::kCmdBufferCompatible});
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cuda_scatter, jaxmpm::scatter_handler, jaxmpm::scatter_binding(), {ffi::Traits::kCmdBufferCompatible});
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cuda_gather, jaxmpm::gather_handler, jaxmpm::gather_binding(), {ffi::Traits::kCmdBufferCompatible});
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cuda_contract, jaxmpm::contract_handler, jaxmpm::contract_binding(), {ffi::Traits::kCmdBufferCompatible});
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxmpm_cuda_cell_sums, jaxmpm::cell_sums_handler, jaxmpm::cell_sums_binding(), {ffi::Traits::kCmdBufferCompatible});
#pragma GCC visibility pop
