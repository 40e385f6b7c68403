// The forks of a large part, made by all threads of a parallel region.
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <vector>

#include "bins.h"
#include "cell_sort.h"
#include "forks.h"
#include "grid.h"
#include "memory.h"
#include "reinsert.h"
#include "tasks.h"

namespace parhelion::tree {

class SharedForks {
 public:
  // Threads that have nothing else to do help; all are there at the region's next barrier. spare:
  // room for as many primitives as the part has.
  void begin(const Part& part, Ref* spare) {
    guard_.run([&] { grow(part, {spare, 0, nullptr, &top_}); });
  }
  // After that barrier. Throws if there was no memory.
  const Fork& finish() {
    guard_.check();
    Reinsertion::run_together(*top_, 2);
    return *top_;
  }

 private:
  // Of what is above parts of kForksATask, or changed by moves there: it costs its surface alone. A
  // share of that of the whole box would be more than all nodes of a model that is a speck in it.
  static constexpr Upkeep kAbove = {0.0f, 0.0f};
  // What has fewer cells of a grid is not divided by it.
  static constexpr size_t kCellsAFork = 256;

  // Where a part's forks go, and room for as many primitives as it has.
  struct Place {
    Ref* spare;
    int levels;
    Fork* parent;
    Fork** link;
  };
  // Not yet measured.
  struct Below {
    Ref* refs;
    size_t size;
    Place place;
  };

  // What is larger than a task is divided, and all parts of it are left to whoever has time: nobody
  // waits for a part that another makes.
  void grow(const Part& part, const Place& place) {
    if (part.size <= kForksATask) {
      const Upkeep upkeep = upkeep_of(part, leaves_room(part));
      Fork& f = fork(part, upkeep, place.levels, add_room(part.size));
      Reinsertion::run(f, 1);
      put(f, place);
      return;
    }
    const std::vector<Below> parts = divide_by_cells(part, place);
    for (const Below& p : parts) {
      later([=, this] {
        Part below = measure_by<ByTasks>(p.size, [&](size_t i) -> const Ref& { return p.refs[i]; });
        below.refs = p.refs;
        grow(below, p.place);
      });
    }
    if (!parts.empty()) return;
    Part left, right;
    halve(part, place.levels, left, right);
    Fork& f = add_above(part.size, part.box, place);
    const Place by_left = {place.spare, place.levels + 1, &f, &f.left};
    const Place by_right = {place.spare + left.size, place.levels + 1, &f, &f.right};
    later([=, this] { grow(left, by_left); });
    later([=, this] { grow(right, by_right); });
  }

  // By planes between the cells of a grid, as long as these are fine beside what is divided: the
  // parts that are left, which change places with their room. None where no such plane divides it.
  std::vector<Below> divide_by_cells(const Part& part, const Place& place) {
    if (place.levels >= kMostForks) return {};
    const Grid grid(part.centers, part.size);
    const CellSort<ByTasks> sort(grid, part.size,
                                 [&](size_t first, size_t, Ref*) { return part.refs + first; });
    std::vector<std::uint16_t> part_of(grid.count());
    std::vector<Below> below;
    divide(grid, sort.bins(), all_of(grid, sort.bins()), place, part_of, below);
    if (below.size() < 2) return {};
    const std::vector<size_t> begin = sort.sort_to(part.refs, place.spare, below.size(), part_of);
    for (size_t p = 0; p < below.size(); ++p) {
      below[p].refs = place.spare + begin[p];
      below[p].place.spare = part.refs + begin[p];
    }
    return below;
  }
  void divide(const Grid& grid, const std::vector<Bin>& bins, const Cells& cells,
              const Place& place, std::vector<std::uint16_t>& part_of, std::vector<Below>& below) {
    Cells left = cells, right;
    if (cells.sum.count > kForksATask && cells.cells() >= kCellsAFork &&
        place.levels < kMostForks && split(grid, bins, left, right)) {
      Fork& f = add_above(cells.sum.count, cells.sum.box, place);
      divide(grid, bins, left, {nullptr, place.levels + 1, &f, &f.left}, part_of, below);
      divide(grid, bins, right, {nullptr, place.levels + 1, &f, &f.right}, part_of, below);
    } else {
      set_part(grid, cells, below.size(), part_of);
      below.push_back({nullptr, cells.sum.count, place});
    }
  }

  template <class F>
  void later(const F& f) {
    do_later([this, f] { guard_.run(f); });
  }

  // Apart from what is below it.
  Fork& add_above(size_t size, const Extent& box, const Place& place) {
    Fork& f = add_room(0).add({nullptr, size, box, {}}, kAbove);
    f.cost[0] = Fork::kUnknown;
    put(f, place);
    return f;
  }
  static void put(Fork& f, const Place& place) {
    f.parent = place.parent;
    *place.link = &f;
  }

  ForkRoom& add_room(size_t primitives) {
    const std::lock_guard lock(mutex_);
    return rooms_.emplace_back(primitives);
  }

  Fork* top_ = nullptr;
  MemoryGuard guard_;
  std::mutex mutex_;
  std::deque<ForkRoom> rooms_;
};

}  // namespace parhelion::tree
