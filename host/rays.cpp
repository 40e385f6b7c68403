#include "rays.h"

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <string>

#include "../core/path.h"
#include "errors.h"
#include "place.h"
#include "threads.h"

namespace parhelion {
namespace {

constexpr std::chrono::milliseconds kBetweenStops{50};

DVec3 vector(const Numbers& of, size_t i) { return {of.at(i, 0), of.at(i, 1), of.at(i, 2)}; }

bool finite(DVec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

bool starts(const UserRays& rays, size_t i) {
  return rays.from ? rays.from[i].slot.leaf != kNone : finite(vector(rays.origins, i));
}
bool goes(const UserRays& rays, size_t i) {
  const DVec3 d = vector(rays.directions, i);
  return finite(d) && (d.x != 0.0 || d.y != 0.0 || d.z != 0.0);
}

bool is_ray(const UserRays& rays, size_t i) {
  return starts(rays, i) && goes(rays, i) && rays.limits.at(i, 0) >= 0.0;
}

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.9g", x);
  return buffer;
}

// What is wrong with a ray that is none.
std::string problem(const UserRays& rays, size_t i) {
  const auto wrong = [&](const char* field, const std::string& what) {
    return std::string(field) + "[" + std::to_string(i) + "] " + what;
  };
  const auto no_vector = [&](const char* field, DVec3 v) {
    return wrong(field, std::string("is (") + text(v.x) + ", " + text(v.y) + ", " + text(v.z) +
                            (finite(v) ? "), which is no direction" : "); must be finite"));
  };
  if (!starts(rays, i)) {
    return rays.from ? wrong("origins", "has met nothing; rays set off from hits[hits.hit]")
                     : no_vector("origins", vector(rays.origins, i));
  }
  if (!goes(rays, i)) return no_vector("directions", vector(rays.directions, i));
  const double limit = rays.limits.at(i, 0);
  if (!(limit >= 0.0)) return wrong("limits", "is " + text(limit) + "; must be >= 0");
  return "the arrays were changed while they were read";
}

// Numbers of `count` rays from `first` on, by component; after the last ray it goes on with that.
template <size_t kColumns>
void read(const Numbers& of, size_t first, size_t count, double (*to)[kBatch]) {
  const auto copy = [&](const auto* rows) {
    for (size_t k = 0; k < kBatch; ++k) {
      const auto* row = rows + (of.one ? 0 : std::min(k, count - 1) * kColumns);
      for (size_t c = 0; c < kColumns; ++c) to[c][k] = static_cast<double>(row[c]);
    }
  };
  if (of.is_double) {
    copy(static_cast<const double*>(of.row(first)));
  } else {
    copy(static_cast<const float*>(of.row(first)));
  }
}

Vec3 vector_at(const float (&rows)[3][kBatch], size_t k) {
  return {rows[0][k], rows[1][k], rows[2][k]};
}

// From what others have met, on the side that rays go to. False where one of them is nothing.
bool leave(const Met* from, size_t count, RayBatch& rays) {
  bool all = true;
  for (u32 k = 0; k < kBatch; ++k) {
    const Met& m = from[std::min<size_t>(k, count - 1)];
    const bool behind = baseline::dot(vector_at(rays.direction, k), m.normal) < 0.0f;
    const Vec3 o = baseline::ray_origin(m.point, m.normal, m.error, behind);
    rays.origin[0][k] = o.x, rays.origin[1][k] = o.y, rays.origin[2][k] = o.z;
    rays.self.leaf[k] = m.slot.leaf, rays.self.lane[k] = m.slot.lane;
    rays.self.instance[k] = m.slot.instance;
    rays.inward |= (behind != (m.inside_out != 0) ? 1u : 0u) << k;
    all &= m.slot.leaf != kNone;
  }
  return all;
}

// `count` rays from `first` on, at most a batch, as kernels take them; they begin so far from where
// they were given. Returns which is the first that is none, `count` if all may be asked.
size_t begin(const Scene& scene, const Kernels& kernels, const UserRays& users, size_t first,
             size_t count, RayBatch& rays, double (&skipped)[kBatch]) {
  UserBatch own;
  read<3>(users.directions, first, count, own.direction);
  read<1>(users.limits, first, count, &own.limit);
  if (!users.from) read<3>(users.origins, first, count, own.origin);
  rays.lanes = (1u << count) - 1;
  rays.inward = 0;
  bool plain =
      kernels.begin_rays(scene.view().bounds, scene.scale(), !users.from, own, rays, skipped);
  if (users.from) {
    plain &= leave(users.from + first, count, rays);
  } else {
    std::fill_n(rays.self.leaf, kBatch, kNoSlot.leaf);
    std::fill_n(rays.self.lane, kBatch, kNoSlot.lane);
    std::fill_n(rays.self.instance, kBatch, kNoSlot.instance);
  }
  size_t k = plain ? count : 0;
  while (k < count && is_ray(users, first + k)) ++k;
  return k;
}

// Calls f(from, to) for [0, n), so many at a time, by all threads. Returns whether it was not
// stopped: some are left out then.
template <class F>
bool in_turns(size_t n, size_t at_once, const Stop& stop, const F& f) {
  std::atomic<bool> stopped{false};
#pragma omp parallel if (n > kFewElements)
  {
    const bool asks = omp_get_thread_num() == 0;
    auto asked = std::chrono::steady_clock::now();
#pragma omp for schedule(dynamic, 1)
    for (size_t c = 0; c < (n + at_once - 1) / at_once; ++c) {
      if (stopped.load(std::memory_order_relaxed)) continue;
      f(c * at_once, std::min(n, (c + 1) * at_once));
      if (!asks || std::chrono::steady_clock::now() < asked + kBetweenStops) continue;
      if (stop()) stopped = true;
      asked = std::chrono::steady_clock::now();
    }
  }
  return !stopped;
}

// Calls f(from, count, batches, skipped) of all rays, some at a time. tree: or else they are slow,
// and fewer at a time.
template <class F>
bool for_rays(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
              const Stop& stop, const F& f) {
  std::atomic<size_t> none{rays.n};  // the first that is no ray
  const bool all = in_turns(rays.n, tree ? kRaysAtOnce : kBatch, stop, [&](size_t from, size_t to) {
    RayBatch batch[kBatchesAtOnce];
    double skipped[kBatchesAtOnce][kBatch];
    for (size_t i = from; i < to; i += kBatch) {
      const size_t b = (i - from) / kBatch, count = std::min<size_t>(kBatch, to - i);
      const size_t good = begin(scene, kernels, rays, i, count, batch[b], skipped[b]);
      size_t known = none.load();
      while (good < count && i + good < known && !none.compare_exchange_weak(known, i + good)) {
      }
    }
    if (none.load(std::memory_order_relaxed) == rays.n) f(from, to - from, batch, skipped);
  });
  if (!all) return false;  // not all were looked at
  if (none < rays.n) throw SceneError(problem(rays, none));
  return true;
}

PrimitivePlace place_of(const SceneView& view, Slot slot) {
  if (slot.leaf == kNone) return {};
  return baseline::with_primitive(view, slot, [&](const auto&, u32 id) {
    return place_of(view, baseline::shape_of(view, id), id, slot);
  });
}

}  // namespace

bool intersect(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
               const RayHits& hits, const Stop& stop) {
  const SceneView& view = scene.view();
  const auto number = [](u32 n) { return n == kNone ? std::int64_t{-1} : std::int64_t{n}; };
  return for_rays(
      scene, kernels, rays, tree, stop,
      [&](size_t from, size_t count, const RayBatch* batch, const double (*skipped)[kBatch]) {
        HitBatch found[kBatchesAtOnce];
        kernels.intersect(view, batch, batches(count), tree, found);
        for (size_t k = 0; k < count; ++k) {
          const size_t i = from + k, b = k / kBatch, lane = k % kBatch;
          const Hit hit = hit_at(found[b], lane);
          const PrimitivePlace place = place_of(view, hit.slot);
          const double distance = (static_cast<double>(hit.t) + skipped[b][lane]) * view.unit;
          hits.distance[i] = place.shape == kNone ? std::numeric_limits<double>::infinity()
                                                  : std::min(distance, rays.limits.at(i, 0));
          hits.shape[i] = static_cast<std::int32_t>(number(place.shape));
          hits.primitive[i] = number(place.primitive);
          hits.instances[i] = static_cast<std::int32_t>(number(place.instances));
          hits.copy[i] = number(place.copy);
          hits.rays[i] = {vector_at(batch[b].origin, lane), vector_at(batch[b].direction, lane),
                          hit};
        }
      });
}

bool occluded(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
              u8* found, const Stop& stop) {
  return for_rays(scene, kernels, rays, tree, stop,
                  [&](size_t from, size_t count, const RayBatch* batch, const auto*) {
                    u32 met[kBatchesAtOnce];
                    kernels.occluded(scene.view(), batch, batches(count), tree, met);
                    for (size_t k = 0; k < count; ++k) {
                      found[from + k] = (met[k / kBatch] >> k % kBatch & 1u) != 0;
                    }
                  });
}

bool find_points(const Scene& scene, const Kernels& kernels, const HitRay* rays, size_t n, Met* met,
                 const Stop& stop) {
  return in_turns(n, kRaysAtOnce, stop, [&](size_t from, size_t to) {
    kernels.points_met(scene.view(), rays + from, to - from, met + from);
  });
}

}  // namespace parhelion
