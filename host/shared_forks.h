// The forks of a large part, made by all threads of a parallel region.
#pragma once
#include <deque>
#include <mutex>

#include "memory.h"
#include "reinsert.h"
#include "tasks.h"

namespace parhelion::tree {

class SharedForks {
 public:
  // Threads that have nothing else to do help; all are there at the region's next barrier. spare:
  // room for as many primitives as the part has.
  void begin(const Part& part, Ref* spare) { grow(part, spare, 0, nullptr, &top_); }
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

  // A thread goes on with left halves, and waits for no right ones: while it did, it could take no
  // tasks but those that it had made itself.
  void grow(Part part, Ref* spare, int levels, Fork* parent, Fork** place) {
    guard_.run([&] {
      for (; part.size > kForksATask; ++levels) {
        Fork& f = add_room(0).add(part, kAbove);
        f.cost[0] = Fork::kUnknown;
        f.parent = parent;
        *place = &f;
        Part left, right;
        Ref* rest = spare;
        if (part.size > kSplitByTasks && levels < kMostForks &&
            split_by_tasks(part, spare, left, right)) {
          rest = part.refs;
          f.refs = nullptr;  // they have moved, and halves use their place, too
        } else {
          halve(part, levels, left, right);
        }
        do_later([this, &f, right, room = rest + left.size, levels] {
          grow(right, room, levels + 1, &f, &f.right);
        });
        part = left, spare = rest, parent = &f, place = &f.left;
      }
      const Upkeep upkeep = upkeep_of(part, leaves_room(part));
      Fork& f = fork(part, upkeep, levels, add_room(part.size));
      Reinsertion::run(f, 1);
      f.parent = parent;
      *place = &f;
    });
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
