// A grid over the centres of many primitives, and how its cells are divided into the children of a
// node.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sah.h"

namespace parhelion::tree {

// Grids have a cell for so many primitives on average, and at most kMostCells. A node is made of no
// fewer than kCellsANode cells.
inline constexpr size_t kPerCell = 8, kMostCells = 32768, kCellsANode = 512;
// A cell of so many times the usual number of primitives is crowded; of the grid over all, in which
// a surface alone leaves most cells empty, it takes more. One of kSampled primitives is looked at
// to find most parts that have too many such cells; where so few lie in a cell that chance makes
// some crowded, it takes twice as many.
inline constexpr size_t kCrowd = 4, kCrowdOfAll = 8, kSampled = 16;

// Cells about as long as wide, over the centres of n primitives.
struct Grid {
  Point low, scale, last;
  u32 size[3] = {1, 1, 1};

  Grid(const Extent& centers, size_t n) : low(centers.low) {
    float extent[4];
    (centers.high - centers.low).store(extent);
    const double wanted = static_cast<double>(std::clamp(n / kPerCell, kCellsANode, kMostCells));
    bool wide[3];
    for (int k = 0; k < 3; ++k) wide[k] = extent[k] > 0.0f;
    // An axis of less than a cell is left out, and the others have its cells.
    double side = 0.0;
    for (bool again = true; again;) {
      double volume = 1.0;
      int axes = 0;
      for (int k = 0; k < 3; ++k) {
        if (wide[k]) volume *= static_cast<double>(extent[k]), ++axes;
      }
      if (axes == 0) break;
      side = std::pow(volume / wanted, 1.0 / axes);
      again = false;
      for (int k = 0; k < 3; ++k) {
        if (wide[k] && static_cast<double>(extent[k]) < side) wide[k] = false, again = true;
      }
    }
    float s[4] = {}, l[4] = {};
    for (int k = 0; k < 3; ++k) {
      if (!wide[k] || !(side > 0.0)) continue;
      size[k] = static_cast<u32>(static_cast<double>(extent[k]) / side);
      const float a = static_cast<float>(size[k]) * (1.0f - 1e-6f) / extent[k];
      if (!std::isfinite(a)) {
        size[k] = 1;
        continue;
      }
      s[k] = a;
      l[k] = static_cast<float>(size[k] - 1);
    }
    scale = Point::of(s);
    last = Point::of(l);
  }

  size_t count() const { return size_t{size[0]} * size[1] * size[2]; }
  u32 index(u32 x, u32 y, u32 z) const { return x + size[0] * (y + size[1] * z); }
  u32 cell_of(const Ref& r) const {
    int c[4];
    min((center_of(r) - low) * scale, last).truncate(c);
    return index(static_cast<u32>(c[0]), static_cast<u32>(c[1]), static_cast<u32>(c[2]));
  }
};

// Those of a grid's cells that lie in a box of them.
struct Cells {
  u32 low[3], high[3];
  Bin sum;
  bool whole;  // cannot be divided

  size_t cells() const {
    return size_t{high[0] - low[0]} * (high[1] - low[1]) * (high[2] - low[2]);
  }
};

inline Cells all_of(const Grid& grid, const std::vector<Bin>& bins) {
  Cells all{{0, 0, 0}, {grid.size[0], grid.size[1], grid.size[2]}, {}, false};
  for (const Bin& b : bins) all.sum.grow(b);
  return all;
}

// Says of each of the cells which part it belongs to.
inline void set_part(const Grid& grid, const Cells& cells, size_t part,
                     std::vector<std::uint16_t>& part_of) {
  for (u32 z = cells.low[2]; z < cells.high[2]; ++z) {
    for (u32 y = cells.low[1]; y < cells.high[1]; ++y) {
      for (u32 x = cells.low[0]; x < cells.high[0]; ++x) {
        part_of[grid.index(x, y, z)] = static_cast<std::uint16_t>(part);
      }
    }
  }
}

// Most of n primitives, of which each cell has count(cell), lie in cells of so many times the usual
// number: a grid of their own would still tell them poorly apart.
template <class Cell, class Count>
bool crowded(const std::vector<Cell>& cells, size_t n, size_t times, const Count& count) {
  size_t crowd = 0;
  for (const Cell& c : cells) {
    const size_t here = count(c);
    if (here * cells.size() > times * n) crowd += here;
  }
  return 2 * crowd > n;
}

// The same of n primitives, of which every `step`th is looked at: ref_of(i).
template <class RefOf>
bool crowded(const Grid& grid, size_t n, size_t step, size_t times, const RefOf& ref_of) {
  std::vector<u32> cells(grid.count());
  for (size_t i = 0; i < n; i += step) ++cells[grid.cell_of(ref_of(i))];
  return crowded(cells, (n - 1) / step + 1, times, [](u32 count) { return count; });
}

// Divides cells in two of the least expected cost, of which the second goes to `right`.
inline bool split(const Grid& grid, const std::vector<Bin>& bins, Cells& left, Cells& right) {
  std::vector<Bin> slab[3];
  for (size_t k = 0; k < 3; ++k) slab[k].resize(left.high[k] - left.low[k]);
  for (u32 z = left.low[2]; z < left.high[2]; ++z) {
    for (u32 y = left.low[1]; y < left.high[1]; ++y) {
      Bin row;
      for (u32 x = left.low[0]; x < left.high[0]; ++x) {
        const Bin& b = bins[grid.index(x, y, z)];
        if (b.count == 0) continue;
        slab[0][x - left.low[0]].grow(b);
        row.grow(b);
      }
      slab[1][y - left.low[1]].grow(row);
      slab[2][z - left.low[2]].grow(row);
    }
  }
  int best_axis = -1;
  size_t best_cut = 0;
  float best_cost = INFINITY;
  for (int k = 0; k < 3; ++k) {
    size_t cut = 0;
    const float cost = best_of(slab[k].data(), slab[k].size(), cut);
    if (cost < best_cost) best_cost = cost, best_axis = k, best_cut = cut;
  }
  if (best_axis < 0) {
    left.whole = true;
    return false;
  }
  right = left;
  left.high[best_axis] = right.low[best_axis] = left.low[best_axis] + static_cast<u32>(best_cut);
  left.sum = right.sum = Bin();
  for (size_t i = 0; i < slab[best_axis].size(); ++i) {
    (i < best_cut ? left : right).sum.grow(slab[best_axis][i]);
  }
  return true;
}

// Up to sixteen parts, made by dividing the one of largest surface again and again.
inline int children_of(const Grid& grid, const std::vector<Bin>& bins, const Cells& all,
                       Cells (&child)[16]) {
  int count = 1;
  child[0] = all;
  while (count < 16) {
    int next = -1;
    float largest = -1.0f;
    for (int i = 0; i < count; ++i) {
      if (child[i].whole || child[i].sum.count <= kLeafSize) continue;
      const float size = child[i].sum.box.half_area();
      if (size > largest) next = i, largest = size;
    }
    if (next < 0) break;
    if (split(grid, bins, child[next], child[count])) ++count;
  }
  return count;
}

}  // namespace parhelion::tree
