// Forks put where the tree over them costs less. Dividing by planes, top down, keeps what is large
// with what happens to lie on its side, such as a floor with the things on one half of it.
// Method: J. Bittner, M. Hapala and V. Havran, "Fast Insertion-Based Optimization of Bounding
// Volume Hierarchies", Computer Graphics Forum 32(1), 2013.
#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

#include "forks.h"
#include "memory.h"

namespace parhelion::tree {

class Reinsertion {
 public:
  // Tries the largest forks below `top`, so many times, and says anew what all of them cost.
  static void run(Fork& top, int turns) {
    Reinsertion r(top);
    for (int turn = 0; turn < turns; ++turn) {
      for (Fork* f : r.largest()) r.move(*f);
    }
    reweigh(top);
  }
  // As that, but by all threads, outside of a parallel region: of so many at a time places are
  // looked for before any is moved, and looked for again only for those that had one then.
  static void run_together(Fork& top, int turns) {
    Reinsertion r(top);
    std::vector<Fork*> tried;
    bool has_place[kTogether] = {};
    MemoryGuard guard;
#pragma omp parallel
    {
      Room room;
      for (int turn = 0; turn < turns; ++turn) {
#pragma omp barrier  // others may still look at those of the last turn
#pragma omp single
        guard.run([&] { tried = r.largest(); });
        for (size_t first = 0; first < tried.size(); first += kTogether) {
          const size_t count = std::min(kTogether, tried.size() - first);
#pragma omp for schedule(dynamic, 1)
          for (size_t i = 0; i < count; ++i) {
            guard.run([&] { has_place[i] = r.place_for(*tried[first + i], room) != nullptr; });
          }
#pragma omp single
          for (size_t i = 0; i < count; ++i) {
            guard.run([&] {
              if (has_place[i]) r.move(*tried[first + i]);
            });
          }
        }
      }
    }
    guard.check();
    reweigh(top);
  }

 private:
  // Of so many primitives one is tried, but no more than kMost: what lies below them is small.
  static constexpr size_t kTriedOf = 64, kMost = 1024, kTogether = 24;

  // Where a fork may go beside, and by how much the forks above it grow then, in surface.
  struct Place {
    float above;
    u32 number;  // of equal ones the first is the next, so that all libraries make the same tree
    Fork* beside;
    bool operator<(const Place& p) const {
      return above > p.above || (above == p.above && number > p.number);
    }
  };
  // A fork above one that is to be taken out: its box without that one, and its half that is not
  // above it.
  struct Above {
    Fork *fork, *other;
    Extent box;
  };
  // What a search needs room for.
  struct Room {
    std::vector<Above> path;
    std::vector<Place> heap;
  };

  Fork& top_;
  Room room_;

  explicit Reinsertion(Fork& top) : top_(top) {}

  // Largest first; none is the top or one of its halves.
  std::vector<Fork*> largest() const {
    std::vector<Place> heap;  // a place is where a fork is now; the largest has the least `above`
    u32 number = 0;
    const auto add = [&](Fork* f) {
      heap.push_back({-f->box.half_area(), ++number, f});
      __builtin_prefetch(f->left);
      __builtin_prefetch(f->right);
      std::push_heap(heap.begin(), heap.end());
    };
    const size_t count = std::min(top_.size / kTriedOf, kMost);
    std::vector<Fork*> found;
    if (top_.left) add(top_.left), add(top_.right);
    while (!heap.empty() && found.size() < count) {
      std::pop_heap(heap.begin(), heap.end());
      Fork* f = heap.back().beside;
      heap.pop_back();
      if (f->parent != &top_) found.push_back(f);
      if (f->left) add(f->left), add(f->right);
    }
    return found;
  }

  static Extent both(const Extent& a, const Extent& b) {
    Extent e = a;
    e.grow(b);
    return e;
  }
  static Fork*& link_to(Fork& f) { return f.parent->left == &f ? f.parent->left : f.parent->right; }
  static Fork* other_half(const Fork& f) {
    return f.parent->left == &f ? f.parent->right : f.parent->left;
  }

  // From a fork whose halves have changed up to the top. Their primitives are in one place no more,
  // and what they cost beside their surface is what the top does.
  void refit(Fork* f) {
    for (;; f = f->parent) {
      f->box = both(f->left->box, f->right->box);
      f->size = f->left->size + f->right->size;
      f->refs = nullptr;
      f->upkeep = top_.upkeep;
      f->cost[0] = Fork::kUnknown;
      if (f == &top_) return;
    }
  }

  // If the forks above grow less with it in another place, a fork and the one above it are taken
  // out and go there.
  void move(Fork& f) {
    Fork* const beside = place_for(f, room_);
    if (!beside) return;
    Fork& joint = *f.parent;
    Fork* const other = other_half(f);
    link_to(joint) = other;
    other->parent = joint.parent;
    refit(other->parent);
    link_to(*beside) = &joint;
    joint.parent = beside->parent;
    joint.left = beside, joint.right = &f;
    beside->parent = &joint;
    refit(&joint);
  }

  // Beside what a fork costs the least, by branch and bound; none if it is there already.
  Fork* place_for(const Fork& f, Room& room) const {
    if (f.parent == &top_) return nullptr;  // another has been moved there
    const Extent& box = f.box;
    const float own = box.half_area();
    Fork* const now = other_half(f);
    room.path.clear();
    Extent rest = now->box;
    for (const Fork* below = f.parent; below != &top_; below = below->parent) {
      Fork* const other = other_half(*below);
      rest.grow(other->box);
      room.path.push_back({below->parent, other, rest});
    }
    float least = both(box, now->box).half_area();
    for (const Above& a : room.path) least += both(box, a.box).half_area() - a.box.half_area();
    least *= 1.0f - 1e-4f;  // more than rounding
    Fork* best = nullptr;
    u32 number = 0;
    room.heap.clear();
    const auto add = [&](float above, Fork* beside) {
      if (!(above + own < least)) return;
      room.heap.push_back({above, ++number, beside});
      std::push_heap(room.heap.begin(), room.heap.end());
    };
    // Beside or below `beside`, whose box may be without the fork; returns what its halves start
    // with.
    const auto look = [&](float above, Fork* beside, const Extent& without) {
      const float cost = above + both(box, without).half_area();
      if (cost < least && beside != &top_) least = cost, best = beside;
      return cost - without.half_area();
    };
    float above = 0.0f;
    for (auto a = room.path.rbegin(); a != room.path.rend() && above + own < least; ++a) {
      above = look(above, a->fork, a->box);
      add(above, a->other);
    }
    const auto visit = [&](float from, Fork* fork) {
      const float start = look(from, fork, fork->box);
      if (fork->left) add(start, fork->left), add(start, fork->right);
    };
    visit(above, now);  // to no avail where the way down to it was too long already
    while (!room.heap.empty()) {
      std::pop_heap(room.heap.begin(), room.heap.end());
      const Place p = room.heap.back();
      room.heap.pop_back();
      if (p.above + own >= least) break;
      visit(p.above, p.beside);
    }
    return best;
  }

  // Of those that have changed, or had no costs: whatever lies above such a fork is one, too.
  static void reweigh(Fork& f) {
    if (f.cost[0] != Fork::kUnknown) return;
    reweigh(*f.left);
    reweigh(*f.right);
    f.cost_as_leaf();
    weigh(f);
  }
};

}  // namespace parhelion::tree
