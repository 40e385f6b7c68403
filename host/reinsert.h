// Forks put where the tree over them costs less. Dividing by planes, top down, keeps what is large
// with what happens to lie on its side, such as a floor with the things on one half of it.
// Method: J. Bittner, M. Hapala and V. Havran, "Fast Insertion-Based Optimization of Bounding
// Volume Hierarchies", Computer Graphics Forum 32(1), 2013.
#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

#include "forks.h"

namespace parhelion::tree {

class Reinsertion {
 public:
  // Tries the largest forks below `top`, so many times, and says anew what all of them cost.
  static void run(Fork& top, Upkeep upkeep, int turns) {
    Reinsertion r(top);
    for (int turn = 0; turn < turns; ++turn) {
      for (Fork* f : r.largest()) r.move(*f);
    }
    reweigh(top, upkeep);
  }

 private:
  // Of so many primitives one is tried, but no more than kMost: what lies below them is small.
  static constexpr size_t kTriedOf = 64, kMost = 1024;

  // Where a fork may go beside, and by how much the forks above it grow then, in surface.
  struct Place {
    float above;
    size_t number;  // of equal ones the first is the next, so that all libraries make the same tree
    Fork* beside;
    bool operator<(const Place& p) const {
      return above > p.above || (above == p.above && number > p.number);
    }
  };

  Fork& top_;
  std::vector<Place> heap_;

  explicit Reinsertion(Fork& top) : top_(top) {}

  // Largest first; none is the top or one of its halves.
  std::vector<Fork*> largest() const {
    std::vector<Place> heap;  // a place is where a fork is now; the largest has the least `above`
    size_t number = 0;
    const auto add = [&](Fork* f) {
      heap.push_back({-f->part.box.half_area(), ++number, f});
      std::push_heap(heap.begin(), heap.end());
    };
    const size_t count = std::min(top_.part.size / kTriedOf, kMost);
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

  static Extent both(const Fork& a, const Fork& b) {
    Extent e = a.part.box;
    e.grow(b.part.box);
    return e;
  }
  static Fork*& link_to(Fork& f) { return f.parent->left == &f ? f.parent->left : f.parent->right; }

  // From a fork whose halves have changed up to the top. Their primitives are in one place no more.
  void refit(Fork* f) {
    for (;; f = f->parent) {
      f->part.box = both(*f->left, *f->right);
      f->part.size = f->left->part.size + f->right->part.size;
      f->part.refs = nullptr;
      f->cost[0] = Fork::kUnknown;
      if (f == &top_) return;
    }
  }

  // A fork and the one above it are taken out; they go back, with another beside, where the forks
  // above grow the least.
  void move(Fork& f) {
    Fork& joint = *f.parent;
    if (&joint == &top_) return;  // it has been moved there
    Fork& other = joint.left == &f ? *joint.right : *joint.left;
    link_to(joint) = &other;
    other.parent = joint.parent;
    refit(other.parent);
    Fork& beside = place_for(f, other);
    link_to(beside) = &joint;
    joint.parent = beside.parent;
    joint.left = &beside, joint.right = &f;
    beside.parent = f.parent = &joint;
    refit(&joint);
  }

  // The place of least cost, by branch and bound: `old` unless there is a better one.
  Fork& place_for(const Fork& f, Fork& old) {
    const float own = f.part.box.half_area();
    float least = both(f, old).half_area();
    for (const Fork* a = old.parent;; a = a->parent) {
      least += both(f, *a).half_area() - a->part.box.half_area();
      if (a == &top_) break;
    }
    least *= 1.0f - 1e-4f;  // more than rounding
    Fork* best = &old;
    size_t number = 0;
    heap_.assign(1, {0.0f, number, &top_});
    while (!heap_.empty()) {
      std::pop_heap(heap_.begin(), heap_.end());
      const Place p = heap_.back();
      heap_.pop_back();
      if (p.above + own >= least) break;
      const float cost = p.above + both(f, *p.beside).half_area();
      if (cost < least && p.beside != &top_) least = cost, best = p.beside;
      const float above = cost - p.beside->part.box.half_area();
      if (p.beside->left && above + own < least) {
        for (Fork* half : {p.beside->left, p.beside->right}) {
          heap_.push_back({above, ++number, half});
          std::push_heap(heap_.begin(), heap_.end());
        }
      }
    }
    return *best;
  }

  // Of those that have changed, or had no costs: whatever lies above such a fork is one, too.
  static void reweigh(Fork& f, Upkeep upkeep) {
    if (f.cost[0] != Fork::kUnknown) return;
    reweigh(*f.left, upkeep);
    reweigh(*f.right, upkeep);
    f.cost_as_leaf(upkeep);
    weigh(f, upkeep);
  }
};

}  // namespace parhelion::tree
