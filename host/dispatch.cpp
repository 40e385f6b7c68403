#include <cstdlib>
#include <stdexcept>

#include "errors.h"
#include "kernels.h"

#if defined(PARHELION_X86)
#include <cpuid.h>
#endif

namespace parhelion {
namespace {

#if defined(PARHELION_X86)
// __builtin_cpu_supports of Clang 14 knows no lzcnt.
bool has_lzcnt() {
  unsigned a = 0, b = 0, c = 0, d = 0;
  return __get_cpuid(0x80000001u, &a, &b, &c, &d) != 0 && (c & 1u << 5) != 0;
}
#endif

// In rising order; the last that the processor has is the default.
std::vector<const Kernels*> runnable() {
#if defined(PARHELION_X86)
  std::vector<const Kernels*> sets = {&sse42::kKernels};
  __builtin_cpu_init();
  const bool haswell = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") &&
                       __builtin_cpu_supports("bmi2") && has_lzcnt();
  if (haswell) sets.push_back(&avx2::kKernels);
  if (haswell && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
    sets.push_back(&avx512::kKernels);
  }
  return sets;
#else
  return {&baseline::kKernels};
#endif
}

}  // namespace

void check_processor() {
#if defined(PARHELION_X86)
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("sse4.2")) {
    throw std::runtime_error("parhelion needs a processor with SSE4.2 (x86-64-v2)");
  }
#endif
}

std::vector<std::string> instruction_sets() {
  std::vector<std::string> names;
  for (const Kernels* k : runnable()) names.push_back(k->name);
  return names;
}

const Kernels& kernels(const std::string& name) {
  const std::vector<const Kernels*> sets = runnable();
  const char* chosen = std::getenv("PARHELION_ISA");
  const std::string wanted = name.empty() && chosen ? chosen : name;
  if (wanted.empty()) return *sets.back();
  std::string choices;
  for (const Kernels* k : sets) {
    if (wanted == k->name) return *k;
    choices += (choices.empty() ? "" : ", ") + std::string(k->name);
  }
  throw SceneError("unknown instruction set '" + wanted + "' (this machine runs: " + choices + ")");
}

}  // namespace parhelion
