#include "rays.h"

#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <tuple>
#include <variant>

#include "../core/surface.h"
#include "../host/kernels.h"
#include "../host/rays.h"
#include "../host/threads.h"
#include "arrays.h"
#include "lock.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

// --- One by one, on one thread, for tests and measurements ---------------------------------------

// Calls f(first, batches, n) for so many batches of rays at a time, which are given in the user's
// units: origins, unit directions and limits, null for none. Called without the GIL: who changes
// the arrays meanwhile changes what is found, as with NumPy's own functions.
template <class F>
void for_unit_rays(const Scene& scene, const FloatRows& origins, const FloatRows& directions,
                   const float* limits, F&& f) {
  const float scale = static_cast<float>(scene.scale());
  const size_t n = origins.shape(0);
  RayBatch batch[kBatchesAtOnce] = {};
  for (RayBatch& b : batch) {
    std::fill_n(b.self.leaf, kBatch, kNoSlot.leaf);
    std::fill_n(b.self.instance, kBatch, kNoSlot.instance);
  }
  for (size_t first = 0; first < n; first += kRaysAtOnce) {
    const size_t count = batches(std::min(kRaysAtOnce, n - first));
    for (size_t i = 0; i < count; ++i) {
      RayBatch& b = batch[i];
      const size_t from = first + i * kBatch, lanes = std::min<size_t>(kBatch, n - from);
      const float *o = origins.data() + 3 * from, *d = directions.data() + 3 * from;
      for (size_t k = 0; k < lanes; ++k) {
        for (size_t axis = 0; axis < 3; ++axis) {
          b.origin[axis][k] = o[3 * k + axis] * scale;
          b.direction[axis][k] = d[3 * k + axis];
        }
        b.limit[k] = limits ? limits[from + k] * scale : kInfinity;
      }
      b.lanes = (1u << lanes) - 1;
    }
    f(first, batch, count);
  }
}

// Calls f(ray, batch, lane) for those of so many batches from `first` on.
template <class F>
void for_lanes(const RayBatch* rays, size_t first, size_t count, F&& f) {
  for (size_t i = 0; i < count; ++i) {
    for (u32 k = 0; rays[i].lanes >> k != 0; ++k) f(first + i * kBatch + k, i, k);
  }
}

void check_rays(const FloatRows& origins, const FloatRows& directions) {
  if (origins.shape(0) == directions.shape(0)) return;
  throw nb::type_error("as many origins as directions are needed");
}

std::tuple<nb::object, nb::object> nearest(const Scene& scene, const FloatRows& origins,
                                           const FloatRows& directions, bool tree,
                                           const std::string& isa) {
  check_rays(origins, directions);
  const Kernels& k = kernels(isa);
  float* t;
  i64* id;
  nb::object ts = make_array<float>({origins.shape(0)}, t);
  nb::object ids = make_array<i64>({origins.shape(0)}, id);
  {
    const Unlocked unlocked;
    const SceneView& view = scene.view();
    const float unscale = static_cast<float>(1.0 / scene.scale());
    HitBatch hits[kBatchesAtOnce];
    for_unit_rays(scene, origins, directions, nullptr,
                  [&](size_t first, const RayBatch* rays, size_t count) {
                    k.intersect(view, rays, count, tree, hits);
                    for_lanes(rays, first, count, [&](size_t ray, size_t i, u32 lane) {
                      const Hit hit = hit_at(hits[i], lane);
                      t[ray] = hit.t * unscale;
                      id[ray] = -1;
                      if (hit.slot.leaf == kNone) return;
                      baseline::with_primitive(
                          view, hit.slot, [&](const auto&, u32 primitive) { id[ray] = primitive; });
                    });
                  });
  }
  return {ts, ids};
}

nb::object any(const Scene& scene, const FloatRows& origins, const FloatRows& directions,
               const Floats& limits, bool tree, const std::string& isa) {
  check_rays(origins, directions);
  if (limits.shape(0) != origins.shape(0)) throw nb::type_error("a limit is needed for each ray");
  u8* out;
  nb::object result = make_array<u8>({origins.shape(0)}, out);
  const Kernels& k = kernels(isa);
  const Unlocked unlocked;
  u32 met[kBatchesAtOnce];
  for_unit_rays(scene, origins, directions, limits.data(),
                [&](size_t first, const RayBatch* rays, size_t count) {
                  k.occluded(scene.view(), rays, count, tree, met);
                  for_lanes(rays, first, count, [&](size_t ray, size_t i, u32 lane) {
                    out[ray] = (met[i] >> lane & 1u) != 0;
                  });
                });
  return result;
}

// --- Of users, by all threads --------------------------------------------------------------------

constexpr size_t kMetNumbers = sizeof(Met) / sizeof(u32);
constexpr size_t kHitRayNumbers = sizeof(HitRay) / sizeof(u32);
template <size_t kColumns>
using NumberRows = nb::ndarray<const u32, nb::shape<-1, kColumns>, nb::c_contig, nb::device::cpu>;
using MetRows = NumberRows<kMetNumbers>;

// n rays, that set off from `origins`, or what others have met.
UserRays user_rays(size_t n, const std::variant<MetRows, AnyArray>& origins,
                   const AnyArray& directions, const AnyArray& limits) {
  UserRays rays{};
  rays.n = n;
  if (const MetRows* met = std::get_if<MetRows>(&origins)) {
    if (met->shape(0) != n) throw nb::type_error("as many origins as rays are needed");
    rays.from = reinterpret_cast<const Met*>(met->data());
  } else {
    rays.origins = to_numbers("origins", std::get<AnyArray>(origins), 3, n);
  }
  rays.directions = to_numbers("directions", directions, 3, n);
  rays.limits = to_numbers("limits", limits, 1, n);
  return rays;
}

// f(stop) without the GIL; Ctrl-C stops it and is raised.
template <class F>
void interruptibly(const F& f) {
  bool complete;
  {
    const Unlocked unlocked;
    complete = f([] {
      const Locked locked;
      return PyErr_CheckSignals() != 0;
    });
  }
  if (!complete) throw nb::python_error();
}

std::tuple<nb::object, nb::object, nb::object, nb::object, nb::object, nb::object> intersect_rays(
    const Scene& scene, size_t n, const std::variant<MetRows, AnyArray>& origins,
    const AnyArray& directions, const AnyArray& limits, bool tree, const std::string& isa) {
  const Kernels& k = kernels(isa);
  const UserRays rays = user_rays(n, origins, directions, limits);
  RayHits hits;
  u32* of;
  nb::object distance = make_array({rays.n}, hits.distance);
  nb::object shape = make_array({rays.n}, hits.shape);
  nb::object primitive = make_array({rays.n}, hits.primitive);
  nb::object instances = make_array({rays.n}, hits.instances);
  nb::object copy = make_array({rays.n}, hits.copy);
  nb::object all = make_array({rays.n, kHitRayNumbers}, of);
  hits.rays = reinterpret_cast<HitRay*>(of);
  interruptibly([&](const Stop& stop) { return intersect(scene, k, rays, tree, hits, stop); });
  return {distance, shape, primitive, instances, copy, all};
}

nb::object occluded_rays(const Scene& scene, size_t n,
                         const std::variant<MetRows, AnyArray>& origins, const AnyArray& directions,
                         const AnyArray& limits, bool tree, const std::string& isa) {
  const Kernels& k = kernels(isa);
  const UserRays rays = user_rays(n, origins, directions, limits);
  u8* found;
  nb::object result = make_array({rays.n}, found);
  interruptibly([&](const Stop& stop) { return occluded(scene, k, rays, tree, found, stop); });
  return result;
}

nb::object points(const Scene& scene, const NumberRows<kHitRayNumbers>& rays,
                  const std::string& isa) {
  const Kernels& k = kernels(isa);
  const size_t n = rays.shape(0);
  u32* met;
  nb::object result = make_array({n, kMetNumbers}, met);
  interruptibly([&](const Stop& stop) {
    return find_points(scene, k, reinterpret_cast<const HitRay*>(rays.data()), n,
                       reinterpret_cast<Met*>(met), stop);
  });
  return result;
}

}  // namespace

void bind_rays(nb::module_& m, nb::class_<Scene>& scene) {
  nb::dict columns;  // of Met, as rows of numbers, where vectors begin
  columns["point"] = offsetof(Met, point) / sizeof(u32);
  columns["normal"] = offsetof(Met, normal) / sizeof(u32);
  m.attr("met_columns") = columns;
  m.attr("few_rays") = kFewElements;  // one thread takes
  scene.def("intersect", &nearest, "origins"_a, "directions"_a, "tree"_a = true, "isa"_a = "")
      .def("occluded", &any, "origins"_a, "directions"_a, "limits"_a, "tree"_a = true,
           "isa"_a = "");
  m.def("intersect_rays", &intersect_rays, "scene"_a, "n"_a, "origins"_a, "directions"_a,
        "limits"_a, "tree"_a, "isa"_a);
  m.def("occluded_rays", &occluded_rays, "scene"_a, "n"_a, "origins"_a, "directions"_a, "limits"_a,
        "tree"_a, "isa"_a);
  m.def("points_met", &points, "scene"_a, "rays"_a, "isa"_a);
}

}  // namespace parhelion
