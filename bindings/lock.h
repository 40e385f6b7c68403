// Python's lock, let go while the core works and taken again to ask Python something.
//
// When Python ends while other threads are at work it ends each that asks for the lock from then
// on, here or in a function of the user's that is called from here, before 3.14 by unwinding its
// stack, which aborts the process at the first destructor. Such a thread waits instead for the
// process to end, which is soon.
#pragma once
#include <nanobind/nanobind.h>

#include <chrono>
#include <exception>
#include <thread>

namespace parhelion {

[[noreturn]] inline void wait_for_the_end() {
  for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
}

// What `take` returns, which needs Python.
template <class F>
auto or_wait_for_the_end(const F& take) {
  if (!Py_IsInitialized()) wait_for_the_end();
  try {
    return take();
  } catch (const std::exception&) {
    throw;
  } catch (...) {  // what unwinds a thread is no exception of anybody's
    wait_for_the_end();
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
