// Where the threads of OpenMP wake.
#pragma once
#include <memory>

namespace parhelion {

// While it lives, the threads that OpenMP wakes for the caller keep off the processor which the
// caller is on at first. Linux as a virtual machine's guest may have them queue there, though
// another is idle, until it looks for unevenness some milliseconds later; a picture of 120x68 then
// takes 20 ms instead of 13. Nothing where it is told how threads are bound, nor of many threads,
// where to tell each takes longer than it saves. Threads that were told so once stay on the
// processors of then, should the process get more later.
class WakeApart {
 public:
  explicit WakeApart(int threads);
  ~WakeApart();

 private:
  struct Kept;
  std::unique_ptr<Kept> kept_;
};

}  // namespace parhelion
