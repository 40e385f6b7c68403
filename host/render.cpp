#include "render.h"

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stdexcept>

#include "errors.h"
#include "threads.h"
#include "wake_apart.h"

namespace parhelion {

Film::Film(u32 x0, u32 y0, u32 w, u32 h, bool with_features, bool with_errors)
    : x(x0),
      y(y0),
      width(w),
      height(h),
      pixels(Array<FilmPixel>::zeros(static_cast<size_t>(w) * h)),
      features(Array<FeaturePixel>::zeros(with_features ? pixels.size() : 0)),
      prefixes(Array<Prefix>::zeros(with_errors ? pixels.size() : 0)) {}

namespace {

// Keeps the means of a pixel's samples so far, if these are a power of two.
void keep_prefix(Prefix& prefix, const FilmPixel& pixel) {
  if (!std::has_single_bit(pixel.count)) return;
  for (u32 k = 0; k < 3; ++k) {
    prefix.half[k] = prefix.whole[k];
    prefix.whole[k] = baseline::mean(pixel.rgb[k], pixel.count);
  }
}

}  // namespace

void Film::begin(std::span<const u32> counts) {
  if (counts.size() != pixels.size()) {
    throw SceneError("as many numbers are needed as there are pixels");
  }
  for (size_t at = 0; at < pixels.size(); ++at) pixels[at].count = counts[at];
}

void Film::add(const Film& part, std::span<const u32> begun) {
  const u32 x0 = part.x - x, y0 = part.y - y;  // wraps around where it begins before this one
  if (x0 > width || y0 > height || part.width > width - x0 || part.height > height - y0) {
    throw SceneError("the part does not lie within the film");
  }
  if (part.features.empty() != features.empty()) {
    throw SceneError("one has features, and the other has none");
  }
  if (begun.size() != part.pixels.size()) {
    throw SceneError("as many numbers are needed as the part has pixels");
  }
  const auto place = [&](size_t at) {
    return (y0 + at / part.width) * width + x0 + at % part.width;
  };
  for (size_t at = 0; at < part.pixels.size(); ++at) {
    const u32 from = begun[at], to = part.pixels[at].count;
    if (pixels[place(at)].count != from || to < from) {
      throw SceneError("the part does not begin where the film is");
    }
    if (!prefixes.empty() && (from == 0 ? part.prefixes.empty() : to > std::bit_ceil(from + 1))) {
      throw SceneError("the part does not tell errors");
    }
  }
  for (size_t at = 0; at < part.pixels.size(); ++at) {
    const FilmPixel& added = part.pixels[at];
    FilmPixel& pixel = pixels[place(at)];
    const u32 from = pixel.count;
    for (u32 k = 0; k < 3; ++k) {
      pixel.rgb[k].high += added.rgb[k].high;
      pixel.rgb[k].low += added.rgb[k].low;
    }
    baseline::carry(pixel);
    pixel.count = added.count;
    pixel.bad += added.bad;
    if (!features.empty()) features[place(at)] = part.features[at];
    if (prefixes.empty() || pixel.count == from) continue;
    if (from == 0) {
      prefixes[place(at)] = part.prefixes[at];
    } else {
      keep_prefix(prefixes[place(at)], pixel);
    }
  }
}

void Film::means(float* rgb) const {
  for_all(pixels.size(), [&](size_t i) {
    for (size_t k = 0; k < 3; ++k)
      rgb[3 * i + k] = baseline::mean(pixels[i].rgb[k], pixels[i].count);
  });
}

void Film::ranks(Tally FeaturePixel::* tally, std::span<const u32> ids, float* out) const {
  struct Entry {
    u32 id, count;
  };
  bool named = true;
#pragma omp parallel for schedule(static) reduction(&& : named) if (features.size() > kFewElements)
  for (size_t at = 0; at < features.size(); ++at) {
    const FeaturePixel& p = features[at];
    const Tally& t = p.*tally;
    Entry found[kTallySlots] = {};
    Entry* end = found;
    for (u32 i = 0; i < kTallySlots && t.count[i] != 0; ++i) {
      if (t.index[i] >= ids.size()) {
        named = false;
        continue;
      }
      const u32 id = ids[t.index[i]];
      Entry* same = std::find_if(found, end, [&](const Entry& e) { return e.id == id; });
      if (same == end) *end++ = {id, 0};
      same->count += t.count[i];
    }
    std::partial_sort(found, found + kMatteRanks, found + kTallySlots,
                      [](const Entry& a, const Entry& b) {
                        return a.count != b.count ? a.count > b.count : a.id < b.id;
                      });
    for (u32 i = 0; i < kMatteRanks; ++i) {
      float* pair = out + 2 * (at * kMatteRanks + i);
      const Entry& e = found[i];
      pair[0] = std::bit_cast<float>(e.id);
      pair[1] = e.count == 0 ? 0.0f : static_cast<float>(e.count) / static_cast<float>(p.count);
    }
  }
  if (!named) throw std::out_of_range("an index has no id");
}

namespace {

using Clock = std::chrono::steady_clock;

// Often enough to stop well within a second, rarely enough to cost nothing.
constexpr auto kTickInterval = std::chrono::milliseconds(50);
// Between two looks at whether to stop; a millisecond's work, of most scenes.
constexpr u32 kSamplesPerStep = 512;

// What a thread has done so far. Each has a cache line of its own: in one that all write to, every
// tile would take it from all the others, and from whoever looks at what lies beside it.
struct alignas(64) Done {
  std::atomic<u64> samples{0}, rays{0};
};

// What the threads of a pass share. Only thread 0, the caller's own, ticks.
struct Pass {
  const Tick& tick;
  std::vector<Done> done;  // by thread
  std::atomic<bool> stop{false};
  Clock::time_point next = Clock::now() + kTickInterval;
  std::mutex mutex;
  std::condition_variable ended;
  int ended_threads = 0;
  double traversal_seconds = 0.0;

  Pass(const Tick& t, int threads) : tick(t), done(static_cast<size_t>(threads)) {}

  u64 samples() const { return sum(&Done::samples); }
  u64 rays() const { return sum(&Done::rays); }

  void maybe_tick(u64 more_samples, u64 more_rays) {
    if (Clock::now() < next) return;
    if (tick(samples() + more_samples, rays() + more_rays)) {
      stop.store(true, std::memory_order_relaxed);
    }
    next = Clock::now() + kTickInterval;
  }

  // A thread that has no tile left, and what it took to walk trees. Thread 0 goes on ticking until
  // all are here: the others may have much to do yet, and must still be stoppable.
  void end(bool first_thread, int threads, double traversal) {
    std::unique_lock<std::mutex> lock(mutex);
    traversal_seconds += traversal;
    if (++ended_threads == threads) ended.notify_one();
    while (first_thread && ended_threads < threads) {
      if (ended.wait_for(lock, kTickInterval, [&] { return ended_threads == threads; })) return;
      lock.unlock();
      maybe_tick(0, 0);
      lock.lock();
    }
  }

 private:
  u64 sum(std::atomic<u64> Done::* which) const {
    u64 all = 0;
    for (const Done& d : done) all += (d.*which).load(std::memory_order_relaxed);
    return all;
  }
};

// Seconds by the ticks of the kernels' clock, from when it was made on.
class TickClock {
 public:
  double seconds(u64 ticks) const {
    const u64 passed = compiler::ticks() - ticks_;
    const std::chrono::duration<double> since = Clock::now() - start_;
    return passed == 0 ? 0.0
                       : since.count() * (static_cast<double>(ticks) / static_cast<double>(passed));
  }

 private:
  const u64 ticks_ = compiler::ticks();
  const Clock::time_point start_ = Clock::now();
};

// A run of a row's pixels that have as many samples and shall have as many.
struct Run {
  u32 x0, x1, count, target;
};

Run run_at(const Film& film, const Targets& targets, u32 x, u32 end, u32 y) {
  const FilmPixel* row = &film.pixels[static_cast<size_t>(y) * film.width];
  Run run = {x, x + 1, row[x].count, targets.of(film, x, y)};
  while (run.x1 < end && row[run.x1].count == run.count &&
         targets.of(film, run.x1, y) == run.target) {
    ++run.x1;
  }
  return run;
}

// As keep_prefix(), for all pixels of a run.
void keep_prefixes(Film& film, const Run& run, u32 y) {
  if (film.prefixes.empty()) return;
  for (u32 x = run.x0; x < run.x1; ++x) {
    const size_t at = static_cast<size_t>(y) * film.width + x;
    keep_prefix(film.prefixes[at], film.pixels[at]);
  }
}

// What the threads of a pass work with.
struct Job {
  const Kernels& kernels;
  const SceneView& scene;
  Part part;
  Pass& pass;
};

// How a part is cut into tiles, or into regions whose pixels share paths. Regions lie as they do in
// the whole picture, so that a part of it has the same groups: the first may begin before the film.
struct Tiling {
  bool regions;
  u32 edge, x0, y0;  // pixels that lie before the film
  u32 across, down;

  Tiling(const Part& part, u32 tile)
      : regions(part.view.reuse_paths), edge(regions ? kRegion : tile) {
    const Film& film = part.film;
    x0 = regions ? film.x % kRegion : 0, y0 = regions ? film.y % kRegion : 0;
    across = (x0 + film.width + edge - 1) / edge;
    down = (y0 + film.height + edge - 1) / edge;
  }
  i64 count() const { return static_cast<i64>(across) * down; }
};

// Renders a tile of the film, row by row. Returns how many samples.
u64 render_tile(const Job& job, u32 x0, u32 y0, u32 edge, bool ticks, PathStats& stats) {
  Film& film = job.part.film;
  const u32 x1 = std::min(x0 + edge, film.width), y1 = std::min(y0 + edge, film.height);
  u64 done = 0;
  for (u32 y = y0; y < y1; ++y) {
    for (u32 x = x0; x < x1;) {
      const Run run = run_at(film, job.part.targets, x, x1, y);
      x = run.x1;
      const u32 width = run.x1 - run.x0, stride = std::max(1u, kSamplesPerStep / width);
      const size_t place = static_cast<size_t>(y) * film.width + run.x0;
      FeaturePixel* features = film.features.empty() ? nullptr : &film.features[place];
      for (u32 from = run.count; from < run.target;) {
        if (job.pass.stop.load(std::memory_order_relaxed)) break;
        u32 to = from + std::min(stride, run.target - from);
        if (!film.prefixes.empty()) to = std::min(to, std::bit_ceil(from + 1));
        job.kernels.render_row(job.scene, job.part.view, film.y + y, film.x + run.x0,
                               film.x + run.x1, from, to, &film.pixels[place], features, stats);
        keep_prefixes(film, run, y);
        done += u64{width} * (to - from);
        from = to;
        if (ticks) job.pass.maybe_tick(done, stats.rays);
      }
    }
  }
  return done;
}

// Renders a region of the picture whose pixels share paths, as far as it lies in the film: x0, y0
// are its top left pixel in the picture. Returns how many samples the film got.
u64 render_region(const Job& job, u32 x0, u32 y0, bool ticks, PathStats& stats) {
  Film& film = job.part.film;
  u32 target[kRegionPixels];
  Region region = {x0,
                   y0,
                   {},
                   {},
                   film.pixels.data(),
                   film.features.empty() ? nullptr : film.features.data(),
                   film.x,
                   film.y,
                   film.width};
  const u32 left = std::max(x0, film.x), right = std::min(x0 + kRegion, film.x + film.width);
  const u32 top = std::max(y0, film.y), bottom = std::min(y0 + kRegion, film.y + film.height);
  const auto for_each_pixel = [&](auto&& f) {
    for (u32 y = top; y < bottom; ++y) {
      for (u32 x = left; x < right; ++x) f(x - film.x, y - film.y, (y - y0) * kRegion + (x - x0));
    }
  };
  for_each_pixel([&](u32 x, u32 y, u32 at) { target[at] = job.part.targets.of(film, x, y); });
  u64 done = 0;
  while (!job.pass.stop.load(std::memory_order_relaxed)) {
    // Pixels that are behind others go first, so that groups are whole.
    u32 from = kNone;
    for_each_pixel([&](u32 x, u32 y, u32 at) {
      const u32 count = film.pixel(x, y).count;
      if (count < target[at]) from = std::min(from, count);
    });
    if (from == kNone) break;
    u32 to = (from / kRegionSamples + 1) * kRegionSamples;
    if (!film.prefixes.empty()) to = std::min(to, std::bit_ceil(from + 1));
    for_each_pixel([&](u32 x, u32 y, u32 at) {
      const u32 count = film.pixel(x, y).count;
      region.from[at] = count;
      region.to[at] = std::max(count, std::min(to, target[at]));
      done += region.to[at] - count;
    });
    job.kernels.render_region(job.scene, job.part.view, region, stats);
    for_each_pixel([&](u32 x, u32 y, u32 at) {
      if (region.from[at] < region.to[at] && !film.prefixes.empty())
        keep_prefix(film.prefix(x, y), film.pixel(x, y));
    });
    if (ticks) job.pass.maybe_tick(done, stats.rays);
  }
  return done;
}

}  // namespace

PassResult render_pass(const Kernels& kernels, const Scene& scene, std::span<const Part> parts,
                       const RenderOptions& options, const Tick& tick) {
  const SceneView scene_view = scene.view();
  std::vector<Tiling> tilings;
  std::vector<i64> ends;  // of each part's tiles, among those of all
  for (const Part& part : parts) {
    tilings.emplace_back(part, options.tile);
    ends.push_back((ends.empty() ? 0 : ends.back()) + tilings.back().count());
  }
  const i64 tiles = ends.empty() ? 0 : ends.back();
  switch (options.schedule) {
    case Schedule::dynamic_: omp_set_schedule(omp_sched_dynamic, 1); break;
    case Schedule::static_: omp_set_schedule(omp_sched_static, 0); break;
    case Schedule::guided: omp_set_schedule(omp_sched_guided, 1); break;
  }
  Pass pass(tick, options.threads);
  const WakeApart apart(options.threads);
#pragma omp parallel num_threads(options.threads)
  {
    const bool first_thread = omp_get_thread_num() == 0;
    Done& own = pass.done[static_cast<size_t>(omp_get_thread_num())];
    const TickClock clock;
    PathStats stats;
#pragma omp for schedule(runtime) nowait
    for (i64 tile = 0; tile < tiles; ++tile) {
      const auto end = std::upper_bound(ends.begin(), ends.end(), tile);
      const size_t at = static_cast<size_t>(end - ends.begin());
      const Job job = {kernels, scene_view, parts[at], pass};
      const Tiling& tiling = tilings[at];
      const i64 within = tile - (*end - tiling.count());
      const u32 x = static_cast<u32>(within % tiling.across) * tiling.edge;
      const u32 y = static_cast<u32>(within / tiling.across) * tiling.edge;
      stats.rays = 0;
      const u64 done = tiling.regions
                           ? render_region(job, job.part.film.x - tiling.x0 + x,
                                           job.part.film.y - tiling.y0 + y, first_thread, stats)
                           : render_tile(job, x, y, tiling.edge, first_thread, stats);
      own.samples.fetch_add(done, std::memory_order_relaxed);
      own.rays.fetch_add(stats.rays, std::memory_order_relaxed);
    }
    const double traversal = clock.seconds(stats.timed_ticks * kTimedWalks);
    pass.end(first_thread, omp_get_num_threads(), traversal);  // maybe fewer than were asked for
  }
  return {pass.samples(), pass.rays(), pass.traversal_seconds, !pass.stop.load()};
}

void release_threads() { omp_pause_resource_all(omp_pause_hard); }

}  // namespace parhelion
