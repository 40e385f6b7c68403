#include "rows.h"

#include <algorithm>
#include <bit>

#include "../core/random.h"

namespace parhelion {
namespace {

constexpr u32 kFree = ~0u;
// Rows whose slots are fetched before the first of them is looked for
constexpr u32 kAhead = 32;

size_t hash(const u32* row, u32 width) {
  u64 h = 0;
  for (u32 i = 0; i < width; ++i) {
    h = baseline::mix((h ^ row[i]) + 0x9e3779b97f4a7c15ull);
  }
  return static_cast<size_t>(h);
}

}  // namespace

DistinctRows distinct_rows(const u32* rows, u32 n, u32 width) {
  DistinctRows found{std::vector<u32>(n), {}};
  const auto row = [&](u32 i) { return rows + size_t{i} * width; };
  // Open addressing; at most half of the slots are taken. A corner's vertex is shared by six, or
  // so.
  std::vector<u32> slots(std::bit_ceil(n / 4 + 16), kFree);
  // Where a row of this hash is, or its place
  const auto slot = [&](const u32* key, size_t h) {
    size_t at = h & (slots.size() - 1);
    while (slots[at] != kFree && !std::equal(key, key + width, row(found.first[slots[at]]))) {
      at = (at + 1) & (slots.size() - 1);
    }
    return at;
  };
  size_t hashes[kAhead];
  for (u32 begin = 0; begin < n; begin += kAhead) {
    const u32 count = std::min(kAhead, n - begin);
    for (u32 k = 0; k < count; ++k) {
      hashes[k] = hash(row(begin + k), width);
      __builtin_prefetch(&slots[hashes[k] & (slots.size() - 1)]);
    }
    for (u32 k = 0; k < count; ++k) {
      const u32 i = begin + k;
      const size_t at = slot(row(i), hashes[k]);
      if (slots[at] == kFree) {
        slots[at] = static_cast<u32>(found.first.size());
        found.first.push_back(i);
      }
      found.which[i] = slots[at];
      if (2 * found.first.size() > slots.size()) {
        slots.assign(2 * slots.size(), kFree);
        for (u32 r = 0; r < found.first.size(); ++r) {
          const u32* key = row(found.first[r]);
          slots[slot(key, hash(key, width))] = r;
        }
      }
    }
  }
  return found;
}

}  // namespace parhelion
