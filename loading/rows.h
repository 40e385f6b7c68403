// Equal rows of a table.
#pragma once
#include <vector>

#include "../core/types.h"

namespace parhelion {

struct DistinctRows {
  std::vector<u32> which;  // of the different rows each row is
  std::vector<u32> first;  // where each of the different rows stands first, in this order
};

// rows: n of `width` words each.
DistinctRows distinct_rows(const u32* rows, u32 n, u32 width);

}  // namespace parhelion
