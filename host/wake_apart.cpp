#include "wake_apart.h"

#include <omp.h>

#include <cstddef>
#include <vector>

#if defined(__linux__)
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

namespace parhelion {

#if defined(__linux__)

namespace {

constexpr int kMost = 16;

// The processors that it may run on, and those that it may meanwhile.
struct Worker {
  pid_t id;
  cpu_set_t all, others;
};

// The threads that OpenMP keeps for the caller, which lives as long as they do, as last asked for.
thread_local std::vector<pid_t> known;

bool is_ours(pid_t id) { return id != 0 && syscall(SYS_tgkill, getpid(), id, 0) == 0; }

// OpenMP ends some when it is asked for fewer, and all before a fork.
bool all_known(int threads) {
  if (known.size() + 1 != static_cast<std::size_t>(threads)) return false;
  for (const pid_t id : known) {
    if (!is_ours(id)) return false;
  }
  return true;
}

void ask(int threads) {
  std::vector<pid_t> ids(static_cast<std::size_t>(threads));
#pragma omp parallel num_threads(threads)
  ids[static_cast<std::size_t>(omp_get_thread_num())] = static_cast<pid_t>(syscall(SYS_gettid));
  known.clear();
  for (std::size_t i = 1; i < ids.size(); ++i) known.push_back(ids[i]);
}

}  // namespace

struct WakeApart::Kept {
  std::vector<Worker> workers;
};

WakeApart::WakeApart(int threads) {
  cpu_set_t mine;
  if (threads < 2 || threads > kMost || omp_in_parallel() ||
      omp_get_proc_bind() != omp_proc_bind_false || sched_getaffinity(0, sizeof mine, &mine) != 0 ||
      threads > CPU_COUNT(&mine)) {
    return;
  }
  if (!all_known(threads)) {
    ask(threads);
    if (!all_known(threads)) return;  // fewer than were asked for
  }
  const int here = sched_getcpu();
  if (here < 0) return;
  kept_ = std::make_unique<Kept>();
  kept_->workers.reserve(known.size());
  for (const pid_t id : known) {
    Worker w{id, {}, {}};
    if (sched_getaffinity(id, sizeof w.all, &w.all) != 0) continue;
    w.others = w.all;
    CPU_CLR(static_cast<std::size_t>(here), &w.others);
    if (CPU_COUNT(&w.others) == 0 || CPU_EQUAL(&w.others, &w.all)) continue;
    if (sched_setaffinity(id, sizeof w.others, &w.others) == 0) kept_->workers.push_back(w);
  }
}

WakeApart::~WakeApart() {
  if (!kept_) return;
  for (const Worker& w : kept_->workers) {
    cpu_set_t now;
    // What somebody else has said meanwhile stays.
    if (is_ours(w.id) && sched_getaffinity(w.id, sizeof now, &now) == 0 &&
        CPU_EQUAL(&now, &w.others)) {
      sched_setaffinity(w.id, sizeof w.all, &w.all);
    }
  }
}

#else

struct WakeApart::Kept {};
WakeApart::WakeApart(int) {}
WakeApart::~WakeApart() = default;

#endif

}  // namespace parhelion
