#include "memory.h"

#include <omp.h>

#include <algorithm>
#include <cstdio>

#include "errors.h"

namespace parhelion {
namespace {

// Beside what is counted: pages that are used in part, and what the allocator keeps for later.
constexpr u64 kSlack = u64{1} << 22, kSlackOfThread = u64{1} << 21;
constexpr u64 kSlackShare = 16;  // one of so many bytes

const char* const kNames[MemoryPlan::kParts] = {
    "images", "meshes and colours", "instances", "planning of the tree", "tree", "lights"};

std::string amount(u64 bytes) {
  const bool large = bytes >= u64{1} << 30;
  char text[32];
  std::snprintf(text, sizeof text, large ? "%.1f GiB" : "%.0f MiB",
                static_cast<double>(bytes) / (large ? 0x1p30 : 0x1p20));
  return text;
}

}  // namespace

u64 MemoryPlan::peak() const {
  u64 kept = 0, most = 0;
  for (int i = 0; i < kParts; ++i) {
    kept += kept_[i];
    most = std::max(most, kept + passing_[i]);
  }
  return most + most / kSlackShare + kSlack +
         static_cast<u64>(omp_get_max_threads()) * kSlackOfThread;
}

void MemoryPlan::expect(Part part, u64 kept, u64 passing) {
  kept_[part] = kept;
  passing_[part] = passing;
}

void MemoryPlan::check() const {
  const u64 most = peak();
  if (most <= limit_) return;
  std::string parts;
  for (int i = 0; i < kParts; ++i) {
    const u64 own = kept_[i] + passing_[i];
    if (20 * own < most) continue;  // others matter
    parts += (parts.empty() ? " (" : ", ") + std::string(kNames[i]) + " " + amount(own);
  }
  throw ResourceError("the scene takes " + amount(most) + (parts.empty() ? "" : parts + ")"));
}

}  // namespace parhelion
