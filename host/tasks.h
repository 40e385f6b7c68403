// Ways to share f(0) to f(n - 1) out to so many threads; and tasks, which those of a parallel
// region do as they find time.
#pragma once
#include <omp.h>

#include <cstddef>

// OpenMP gives the memory of a task that has ended to one that another thread makes, and nobody
// tells the thread sanitizer of it. So it isn't shown what is written there, which is no more than
// where a task finds what it does; all that tasks do themselves it sees.
#define PH_MAKES_TASKS __attribute__((noinline, no_sanitize("thread")))

namespace parhelion {

// By any thread, before the next barrier is passed.
template <class F>
PH_MAKES_TASKS void do_later(F f) {
#pragma omp task firstprivate(f)
  f();
}

struct ByOneThread {
  static int threads() { return 1; }
  template <class F>
  void operator()(size_t n, const F& f) const {
    for (size_t i = 0; i < n; ++i) f(i);
  }
};

// Outside of a parallel region.
struct ByAllThreads {
  static int threads() { return omp_get_max_threads(); }
  template <class F>
  void operator()(size_t n, const F& f) const {
#pragma omp parallel for schedule(static, 1)
    for (size_t i = 0; i < n; ++i) f(i);
  }
};

// Within one, a task each, all done when it returns.
struct ByTasks {
  static int threads() { return omp_get_num_threads(); }
  template <class F>
  PH_MAKES_TASKS void operator()(size_t n, const F& f) const {
#pragma omp taskloop grainsize(1) shared(f)
    for (size_t i = 0; i < n; ++i) f(i);
  }
};

}  // namespace parhelion
