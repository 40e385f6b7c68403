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

// Where u lies in the whole, and in which of the guide's parts that is.
PH_INLINE u32 place_of(float u) {
  return static_cast<u32>(static_cast<u64>(u * 0x1p24f) * kDistributionWhole >> 24);
}
PH_INLINE u32 part_of(u32 place, u32 count) {
  return static_cast<u32>(static_cast<u64>(place) * count >> 32);
}

// The share in which u falls, and its place within as a new uniform number.
PH_INLINE u32 pick_share(const u32* starts, const u16* guide, u32 count, float u, float& rest) {
  const u32 place = place_of(u), part = part_of(place, count);
  u32 low = guide[part];  // starts[low] <= place, and below that of the `left` cells on
  u32 left = (part + 1 < count ? guide[part + 1] : count - 1) - low + 1;
  while (left > 1) {
    const u32 half = left / 2;
    low = starts[low + half] <= place ? low + half : low;
    left -= half;
  }
  const u32 size = share_end(starts, count, low) - starts[low];
  rest = min(static_cast<float>(place - starts[low]) / static_cast<float>(size), kBelowOne);
  return low;
}

PH_INLINE u64 row_of(const Distribution& d, u32 y) { return static_cast<u64>(y) * d.width; }

PH_INLINE void pick_row(const Distribution& d, float u, CellSample& s) {
  s.y = pick_share(d.rows, d.row_guide, d.height, u, s.u.y);
}
// In the row that has been picked.
PH_INLINE void pick_column(const Distribution& d, float u, CellSample& s) {
  const u64 first = row_of(d, s.y);
  const u32* row = d.columns + first;
  s.x = pick_share(row, d.column_guide + first, d.width, u, s.u.x);
  s.probability = share_of(d.rows, d.height, s.y) * share_of(row, d.width, s.x);
}

PH_INLINE CellSample sample_cell(const Distribution& d, Vec2 u) {
  CellSample s;
  pick_row(d, u.y, s);
  pick_column(d, u.x, s);
  return s;
}

// n cells: what memory is waited for is asked for all of them before any is looked at.
PH_INLINE void sample_cells(const Distribution* const* d, const Vec2* u, u32 n, CellSample* s) {
  const auto guide = [&](u32 i) {
    return d[i]->column_guide + row_of(*d[i], s[i].y) + part_of(place_of(u[i].x), d[i]->width);
  };
  for (u32 i = 0; i < n; ++i) {
    pick_row(*d[i], u[i].y, s[i]);
    compiler::prefetch(guide(i));
  }
  for (u32 i = 0; i < n; ++i) {
    compiler::prefetch(d[i]->columns + row_of(*d[i], s[i].y) + *guide(i));
  }
  for (u32 i = 0; i < n; ++i) pick_column(*d[i], u[i].x, s[i]);
}

PH_INLINE float cell_probability(const Distribution& d, u32 x, u32 y) {
  const u32* row = d.columns + row_of(d, y);
  return share_of(d.rows, d.height, y) * share_of(row, d.width, x);
}

// A number in [0, 1) whose density goes linearly from a to b, not negative, up to a factor.
PH_INLINE float sample_linear(float a, float b, float u) {
  const float root = sqrt(a * a + (b * b - a * a) * u);  // of the quadratic's discriminant
  return a + b > 0.0f ? min(u * (a + b) / (a + root), kBelowOne) : u;
}
PH_INLINE float linear_pdf(float a, float b, float x) {
  return a + b > 0.0f ? 2.0f * (a + (b - a) * x) / (a + b) : 1.0f;
}

}  // namespace parhelion::PH_ISA
