// Cells of a grid, picked in proportion to weights: first a row, then a column in it.
//
// Cumulative weights are whole numbers of 2^-32, near enough: every cell with a weight has at least
// one, sums are exact, and the density is that of what is sampled, bit for bit. The mapping from
// the unit square is monotonous along both axes, so stratified points stay stratified.
//
// The search begins at a guide: H.-C. Chen and Y. Asau, "On generating random variates from an
// empirical distribution", AIIE Transactions 6(2), 1974.
#pragma once
#include "math.h"

namespace parhelion {

// The whole; a share s of it is s / kDistributionWhole.
inline constexpr u32 kDistributionWhole = 0xffffffffu;

struct Distribution {
  const u32* rows;     // by row: where its share begins
  const u32* columns;  // by row and column: where its share of the row begins
  // Of n equal parts of the whole for n rows, and the same of each row for its columns: in which
  // share each begins.
  const u16* row_guide;
  const u16* column_guide;
  u32 width, height;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

struct CellSample {
  u32 x, y;
  Vec2 u;  // new uniform numbers
  float probability;
};

PH_INLINE u32 share_end(const u32* starts, u32 count, u32 i) {
  return i + 1 < count ? starts[i + 1] : kDistributionWhole;
}
PH_INLINE float share_of(const u32* starts, u32 count, u32 i) {
  return static_cast<float>(share_end(starts, count, i) - starts[i]) * 0x1p-32f;
}

// The share in which u falls, and its place within as a new uniform number.
PH_INLINE u32 pick_share(const u32* starts, const u16* guide, u32 count, float u, float& rest) {
  const u64 fraction = static_cast<u64>(u * 0x1p24f);
  const u32 place = static_cast<u32>(fraction * kDistributionWhole >> 24);
  const u32 part = static_cast<u32>(static_cast<u64>(place) * count >> 32);
  u32 low = guide[part];  // starts[low] <= place, and below that of the `left` cells on
  u32 left = (part + 1 < count ? guide[part + 1] : count - 1) - low + 1;
  while (left > 1) {
    const u32 half = left / 2;
    low = starts[low + half] <= place ? low + half : low;
    left -= half;
  }
  const u32 size = share_end(starts, count, low) - starts[low];
  rest = min(static_cast<float>(place - starts[low]) / static_cast<float>(size), 0x1.fffffep-1f);
  return low;
}

PH_INLINE CellSample sample_cell(const Distribution& d, Vec2 u) {
  CellSample s;
  s.y = pick_share(d.rows, d.row_guide, d.height, u.y, s.u.y);
  const u64 first = static_cast<u64>(s.y) * d.width;
  const u32* row = d.columns + first;
  s.x = pick_share(row, d.column_guide + first, d.width, u.x, s.u.x);
  s.probability = share_of(d.rows, d.height, s.y) * share_of(row, d.width, s.x);
  return s;
}

PH_INLINE float cell_probability(const Distribution& d, u32 x, u32 y) {
  const u32* row = d.columns + static_cast<u64>(y) * d.width;
  return share_of(d.rows, d.height, y) * share_of(row, d.width, x);
}

// A number in [0, 1) whose density goes linearly from a to b, not negative, up to a factor.
PH_INLINE float sample_linear(float a, float b, float u) {
  const float root = sqrt(a * a + (b * b - a * a) * u);  // of the quadratic's discriminant
  return a + b > 0.0f ? min(u * (a + b) / (a + root), 0x1.fffffep-1f) : u;
}
PH_INLINE float linear_pdf(float a, float b, float x) {
  return a + b > 0.0f ? 2.0f * (a + (b - a) * x) / (a + b) : 1.0f;
}

}  // namespace parhelion::PH_ISA
