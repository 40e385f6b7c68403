// The choice of an instruction set at run time.
#pragma once
#include <string>
#include <vector>

#include "kernel_table.h"

namespace parhelion {

#if defined(PARHELION_X86)
namespace sse42 {
extern const Kernels kKernels;
}
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}
#else
namespace baseline {
extern const Kernels kKernels;
}
#endif

// Throws std::runtime_error if this machine can run none.
void check_processor();

// The names of the instruction sets that this machine can run, the best last.
std::vector<std::string> instruction_sets();

// The kernels by name. Empty: those of PARHELION_ISA in the environment, else the best that this
// machine can run. Throws SceneError for a name that it cannot.
const Kernels& kernels(const std::string& name = "");

}  // namespace parhelion
