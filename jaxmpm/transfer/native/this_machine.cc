// Prints the best instruction set of this machine: CMakeLists.txt compiles the kernels for it alone where it is asked to.

#include <cstdio>

#include "instructions.h"

int main() {
  const char* best = "portable";
#if defined(__x86_64__)
  if (jaxmpm::runs_avx2()) best = "avx2";
  if (jaxmpm::runs_avx512()) best = "avx512";
#endif
  std::fputs(best, stdout);
}
