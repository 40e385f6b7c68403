#include "threads.h"

#include <omp.h>

#include <vector>

#if defined(__linux__)
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <string>
#endif

namespace parhelion {

#if defined(__linux__)

namespace {

constexpr int kMost = 16;

struct Worker {
  pid_t id;
  cpu_set_t processors;  // that it may run on
};

// The threads that OpenMP keeps for the caller, which lives as long as they do, as last asked for.
thread_local std::vector<pid_t> known;

bool is_ours(pid_t id) {
  return id != 0 && access(("/proc/self/task/" + std::to_string(id)).c_str(), F_OK) == 0;
}

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
    if (!all_known(threads)) return;  // fewer than were asked for, or nobody tells whose they are
  }
  const int here = sched_getcpu();
  if (here < 0) return;
  kept_ = std::make_unique<Kept>();
  for (const pid_t id : known) {
    Worker w{id, {}};
    if (sched_getaffinity(id, sizeof w.processors, &w.processors) != 0) continue;
    cpu_set_t others = w.processors;
    CPU_CLR(static_cast<std::size_t>(here), &others);
    if (CPU_COUNT(&others) == 0 || sched_setaffinity(id, sizeof others, &others) != 0) continue;
    kept_->workers.push_back(w);
  }
}

WakeApart::~WakeApart() {
  if (!kept_) return;
  for (const Worker& w : kept_->workers) {
    if (is_ours(w.id)) sched_setaffinity(w.id, sizeof w.processors, &w.processors);
  }
}

#else

struct WakeApart::Kept {};
WakeApart::WakeApart(int) {}
WakeApart::~WakeApart() = default;

#endif

}  // namespace parhelion
