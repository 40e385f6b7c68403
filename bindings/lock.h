// Python's lock, let go while the core works and taken again to ask Python something.
//
// When Python ends while other threads are at work it ends each that asks for the lock from then
// on, before 3.14 by unwinding its stack, which aborts the process at the first destructor. Such a
// thread waits instead for the process to end, which is soon.
#pragma once
#include <nanobind/nanobind.h>

#include <chrono>
#include <thread>

namespace parhelion {

template <class F>
auto or_wait_for_the_end(const F& take) {
  try {
    return take();
  } catch (...) {  // neither call throws anything else; what unwinds a stack must not be caught
    for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
  }
}

class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {}
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;
  ~Unlocked() {
    or_wait_for_the_end([&] { PyEval_RestoreThread(state_); });
  }

 private:
  PyThreadState* const state_;
};

class Locked {
 public:
  Locked() : state_(or_wait_for_the_end([] { return PyGILState_Ensure(); })) {}
  Locked(const Locked&) = delete;
  Locked& operator=(const Locked&) = delete;
  ~Locked() { PyGILState_Release(state_); }

 private:
  const PyGILState_STATE state_;
};

}  // namespace parhelion
