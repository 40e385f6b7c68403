// What a scene takes while it is made, held against a limit before it is taken: systems promise
// more memory than there is and end whoever uses it, so one cannot wait for an allocation to fail.
#pragma once
#include <atomic>
#include <cstddef>
#include <new>
#include <string>

#include "../core/types.h"

namespace parhelion {

class MemoryPlan {
 public:
  // In the order in which they are made.
  enum Part { images, shapes, instances, planning, tree, lights, kParts };

  // limit: in bytes, beside what the process holds already.
  explicit MemoryPlan(u64 limit) : limit_(limit) {}

  // A part keeps so many bytes, and takes `passing` more while it is made. To be called again when
  // more is known.
  void expect(Part part, u64 kept, u64 passing);
  // Throws ResourceError, which tells all parts, where they exceed the limit.
  void check() const;

  // The most bytes that are held at a time, as far as they are expected.
  u64 peak() const;

 private:
  u64 limit_;
  u64 kept_[kParts] = {}, passing_[kParts] = {};
};

// Nothing may be thrown through OpenMP: runs what may find no memory, and throws after the loop.
class MemoryGuard {
 public:
  template <class F>
  void run(F f) {
    try {
      f();
    } catch (const std::bad_alloc&) {
      failed_ = true;
    }
  }
  void check() const {
    if (failed_) throw std::bad_alloc();
  }

 private:
  std::atomic<bool> failed_ = false;
};

}  // namespace parhelion
