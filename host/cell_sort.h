// Primitives sorted into the cells of a grid, and on to the parts that are made of its cells.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "array.h"
#include "grid.h"
#include "memory.h"
#include "sah.h"

namespace parhelion::tree {

// By `Share`, one of the ways to share work out (tasks.h). What results does not depend on how many
// threads there are: bins are minima, maxima and counts, and what goes to a part keeps its order.
template <class Share>
class CellSort {
 public:
  // Of n primitives; refs_of(first, count, room) tells the boxes of so many, at most kSome: where
  // they are, or made in `room`.
  template <class RefsOf>
  CellSort(const Grid& grid, size_t n, const RefsOf& refs_of)
      : n_(n), cells_(grid.count()), cell_of_(n), bins_(chunks_of(n, grid.count())) {
    MemoryGuard guard;
    share_(bins_.size(), [&](size_t t) {
      guard.run([&] { fill(grid, start(t), start(t + 1), bins_[t], refs_of); });
    });
    guard.check();
    if (bins_.size() == 1) return;
    merged_.resize(cells_);
    share_(bins_.size(), [&](size_t t) {
      const size_t end = cells_ * (t + 1) / bins_.size();
      for (size_t c = cells_ * t / bins_.size(); c < end; ++c) {
        for (const std::vector<Bin>& some : bins_) merged_[c].grow(some[c]);
      }
    });
  }

  // What is in each cell.
  const std::vector<Bin>& bins() const { return bins_.size() > 1 ? merged_ : bins_[0]; }

  // Copies the primitives, or what stands for them, to `sorted`, each part's together, and tells
  // where each begins. part_of: that of a cell.
  template <class Item>
  std::vector<size_t> sort_to(const Item* items, Item* sorted, size_t parts,
                              const std::vector<std::uint16_t>& part_of) const {
    std::vector<std::vector<size_t>> next(bins_.size(), std::vector<size_t>(parts));
    share_(bins_.size(), [&](size_t t) {
      for (size_t c = 0; c < cells_; ++c) next[t][part_of[c]] += bins_[t][c].count;
    });
    std::vector<size_t> begin(parts);
    size_t first = 0;
    for (size_t p = 0; p < parts; ++p) {
      begin[p] = first;
      for (std::vector<size_t>& of_chunk : next) {
        const size_t size = of_chunk[p];
        of_chunk[p] = first;
        first += size;
      }
    }
    share_(bins_.size(), [&](size_t t) {
      for (size_t i = start(t), end = start(t + 1); i < end; ++i) {
        sorted[next[t][part_of[cell_of_[i]]]++] = items[i];
      }
    });
    return begin;
  }

 private:
  const size_t n_, cells_;
  Array<std::uint16_t> cell_of_;
  std::vector<std::vector<Bin>> bins_;  // of each chunk of the primitives
  std::vector<Bin> merged_;
  [[no_unique_address]] const Share share_{};

  // A chunk has as many primitives as there are cells, or more: to clear and sum its bins takes as
  // long as to fill them. So of 262,144 primitives and fewer there are eight at most, as a rule.
  static size_t chunks_of(size_t n, size_t cells) {
    return std::clamp(n / cells, size_t{1}, static_cast<size_t>(Share::threads()));
  }
  size_t start(size_t chunk) const { return n_ * chunk / bins_.size(); }

  template <class RefsOf>
  void fill(const Grid& grid, size_t from, size_t to, std::vector<Bin>& bins,
            const RefsOf& refs_of) {
    bins.resize(cells_);
    for_some(to - from, [&](size_t first, size_t count) {
      Ref room[kSome];
      const Ref* const some = refs_of(from + first, count, room);
      std::uint16_t* const at = cell_of_.data() + from + first;
      for (size_t i = 0; i < count; ++i) at[i] = static_cast<std::uint16_t>(grid.cell_of(some[i]));
      for (size_t i = 0; i < count; ++i) bins[at[i]].add(some[i]);
    });
  }
};

}  // namespace parhelion::tree
