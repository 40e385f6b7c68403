// Rays of the user's own against a scene: many at a time, by all threads.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>

#include "kernel_table.h"
#include "scene.h"

namespace parhelion {

// In the user's units, of each of n rays. They set off from what others have met, on the side
// that they go to, or, where `from` is null, from `origins`.
struct UserRays {
  size_t n;
  Numbers origins;
  const Met* from;
  Numbers directions;  // of any length but 0
  Numbers limits;      // what is farther is not looked for; infinity for none
};

// Of each ray; the numbers are -1, and the distance is infinite, where nothing is met.
struct RayHits {
  double* distance;
  std::int32_t* shape;
  std::int64_t* primitive;  // of the shape
  std::int32_t* instances;  // the shape of instances and the number of the copy, if it is one
  std::int64_t* copy;
  HitRay* rays;
};

// As many rays, and what is found of them, as stay in the first cache (17 KB).
inline constexpr size_t kRaysAtOnce = 256, kBatchesAtOnce = kRaysAtOnce / kBatch;

inline size_t batches(size_t rays) { return (rays + kBatch - 1) / kBatch; }
inline Hit hit_at(const HitBatch& hits, size_t k) {
  return {hits.t[k], {hits.slot.leaf[k], hits.slot.lane[k], hits.slot.instance[k]}};
}

// Whether to stop: asked by the calling thread alone, some times a second.
using Stop = std::function<bool()>;

// False if it was stopped: some rays are not answered then. Else both throw SceneError, naming the
// first ray that is none, if there is one. tree: or else against each primitive.
bool intersect(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
               const RayHits& hits, const Stop& stop);
// Whether anything is in the way.
bool occluded(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
              u8* found, const Stop& stop);

// The points that n rays have met. False if it was stopped.
bool find_points(const Scene& scene, const Kernels& kernels, const HitRay* rays, size_t n, Met* met,
                 const Stop& stop);

}  // namespace parhelion
