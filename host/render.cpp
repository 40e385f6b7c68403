#include "render.h"

#include <omp.h>

#include <atomic>
#include <chrono>

namespace parhelion {

Film::Film(u32 x0, u32 y0, u32 w, u32 h)
    : x(x0), y(y0), width(w), height(h), pixels(static_cast<size_t>(w) * h, FilmPixel{}) {}

void Film::means(float* rgb) const {
  for (const FilmPixel& p : pixels) {
    for (const FilmSum& sum : p.rgb) *rgb++ = baseline::mean(sum, p.count);
  }
}

PassResult render_pass(const Kernels& kernels, const Scene& scene, const RenderView& view,
                       Film& film, u32 first, u32 last, const RenderOptions& options,
                       const Tick& tick) {
  using Clock = std::chrono::steady_clock;
  // Often enough to stop well within a second, rarely enough to cost nothing.
  constexpr auto interval = std::chrono::milliseconds(50);

  constexpr u32 kSamplesPerStep = 128;

  const u32 edge = options.tile;
  const u32 across = (film.width + edge - 1) / edge, down = (film.height + edge - 1) / edge;
  const i64 tiles = static_cast<i64>(across) * down;
  const u64 steps = (last - first + kSamplesPerStep - 1) / kSamplesPerStep;
  const SceneView scene_view = scene.view();
  std::atomic<u64> samples{0}, rays{0};
  std::atomic<bool> stop{false};
  Clock::time_point next = Clock::now() + interval;

  switch (options.schedule) {
    case Schedule::dynamic_: omp_set_schedule(omp_sched_dynamic, 1); break;
    case Schedule::static_: omp_set_schedule(omp_sched_static, 0); break;
    case Schedule::guided: omp_set_schedule(omp_sched_guided, 1); break;
  }
#pragma omp parallel for schedule(runtime) num_threads(options.threads)
  for (i64 tile = 0; tile < tiles; ++tile) {
    const u32 x0 = static_cast<u32>(tile % across) * edge;
    const u32 y0 = static_cast<u32>(tile / across) * edge;
    const u32 x1 = std::min(x0 + edge, film.width), y1 = std::min(y0 + edge, film.height);
    PathStats stats = {0};
    u64 done = 0;
    // A row of a tile at a time, and of many samples only some, so that a stop is never far.
    for (u64 step = 0; step < steps * (y1 - y0) && !stop.load(std::memory_order_relaxed); ++step) {
      const u32 y = y0 + static_cast<u32>(step / steps);
      const u32 from = first + static_cast<u32>(step % steps) * kSamplesPerStep;
      const u32 to = std::min(last, from + kSamplesPerStep);
      FilmPixel* row = &film.pixels[static_cast<size_t>(y) * film.width + x0];
      kernels.render_row(scene_view, view, film.y + y, film.x + x0, film.x + x1, from, to, row,
                         stats);
      done += static_cast<u64>(x1 - x0) * (to - from);
      if (omp_get_thread_num() == 0 && Clock::now() >= next) {
        if (tick(samples.load(std::memory_order_relaxed) + done,
                 rays.load(std::memory_order_relaxed) + stats.rays)) {
          stop.store(true, std::memory_order_relaxed);
        }
        next = Clock::now() + interval;
      }
    }
    samples.fetch_add(done, std::memory_order_relaxed);
    rays.fetch_add(stats.rays, std::memory_order_relaxed);
  }
  return {samples.load(), rays.load(), !stop.load()};
}

void release_threads() { omp_pause_resource_all(omp_pause_hard); }

}  // namespace parhelion
