// Whether this machine runs the instruction sets that kernels are compiled for.
#pragma once

namespace jaxmpm {

inline bool runs_portable() { return true; }

#if defined(__x86_64__)
inline bool runs_avx2() {
  __builtin_cpu_init();
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}
inline bool runs_avx512() {
  return runs_avx2() && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
         __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
}
#endif

}  // namespace jaxmpm
