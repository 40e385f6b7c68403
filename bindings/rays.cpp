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
#include "arrays.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

// --- One by one, on one thread, for tests and measurements ---------------------------------------

// Calls f(first, rays, count) for so many rays at a time, which are given in the user's units:
// origins and unit directions. Called without the GIL: who changes the arrays meanwhile changes
// what is found, as with NumPy's own functions.
template <class F>
void for_unit_rays(const Scene& scene, const FloatRows& origins, const FloatRows& directions,
                   F&& f) {
  const float scale = static_cast<float>(scene.scale());
  const size_t n = origins.shape(0);
  Ray rays[kRaysAtOnce];
  for (size_t first = 0; first < n; first += kRaysAtOnce) {
    const size_t count = std::min(kRaysAtOnce, n - first);
    for (size_t i = 0; i < count; ++i) {
      const Vec3 o = vectors(origins)[first + i];
      const Vec3 scaled = {o.x * scale, o.y * scale, o.z * scale};
      rays[i] = {scaled, vectors(directions)[first + i], kNoSlot, false};
    }
    f(first, rays, count);
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
    nb::gil_scoped_release unlocked;
    const SceneView& view = scene.view();
    const float unscale = static_cast<float>(1.0 / scene.scale());
    float limit[kRaysAtOnce];
    std::fill_n(limit, kRaysAtOnce, kInfinity);
    Hit hits[kRaysAtOnce];
    for_unit_rays(scene, origins, directions, [&](size_t first, const Ray* rays, size_t count) {
      k.intersect(view, rays, limit, count, tree, hits);
      for (size_t i = 0; i < count; ++i) {
        const Slot slot = hits[i].slot;
        t[first + i] = hits[i].t * unscale;
        i64& own = id[first + i];
        own = -1;
        if (slot.leaf == kNone) continue;
        baseline::with_primitive(view, slot,
                                 [&](const auto&, u32 primitive) { own = i64{primitive}; });
      }
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
  nb::gil_scoped_release unlocked;
  const SceneView& view = scene.view();
  const float scale = static_cast<float>(scene.scale());
  float limit[kRaysAtOnce];
  for_unit_rays(scene, origins, directions, [&](size_t first, const Ray* rays, size_t count) {
    for (size_t i = 0; i < count; ++i) limit[i] = limits.data()[first + i] * scale;
    k.occluded(view, rays, limit, count, tree, out + first);
  });
  return result;
}

// --- Of users, by all threads --------------------------------------------------------------------

constexpr size_t kMetNumbers = sizeof(Met) / sizeof(u32);
using MetRows = nb::ndarray<const u32, nb::shape<-1, kMetNumbers>, nb::c_contig, nb::device::cpu>;

// n rays, that set off from `origins`, or what others have met. Raises what check() does.
UserRays checked(size_t n, const std::variant<MetRows, AnyArray>& origins,
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
  nb::gil_scoped_release unlocked;
  check(rays);
  return rays;
}

// f(stop) without the GIL; Ctrl-C stops it and is raised.
template <class F>
void interruptibly(const F& f) {
  bool complete;
  {
    nb::gil_scoped_release unlocked;
    complete = f([] {
      nb::gil_scoped_acquire locked;
      return PyErr_CheckSignals() != 0;
    });
  }
  if (!complete) throw nb::python_error();
}

std::tuple<nb::object, nb::object, nb::object, nb::object, nb::object, nb::object> intersect_rays(
    const Scene& scene, size_t n, const std::variant<MetRows, AnyArray>& origins,
    const AnyArray& directions, const AnyArray& limits, bool tree, const std::string& isa) {
  const Kernels& k = kernels(isa);
  const UserRays rays = checked(n, origins, directions, limits);
  RayHits hits;
  u32* met;
  nb::object distance = make_array({rays.n}, hits.distance);
  nb::object shape = make_array({rays.n}, hits.shape);
  nb::object primitive = make_array({rays.n}, hits.primitive);
  nb::object instances = make_array({rays.n}, hits.instances);
  nb::object copy = make_array({rays.n}, hits.copy);
  nb::object all = make_array({rays.n, kMetNumbers}, met);
  hits.met = reinterpret_cast<Met*>(met);
  interruptibly([&](const Stop& stop) { return intersect(scene, k, rays, tree, hits, stop); });
  return {distance, shape, primitive, instances, copy, all};
}

nb::object occluded_rays(const Scene& scene, size_t n,
                         const std::variant<MetRows, AnyArray>& origins, const AnyArray& directions,
                         const AnyArray& limits, bool tree, const std::string& isa) {
  const Kernels& k = kernels(isa);
  const UserRays rays = checked(n, origins, directions, limits);
  u8* found;
  nb::object result = make_array({rays.n}, found);
  interruptibly([&](const Stop& stop) { return occluded(scene, k, rays, tree, found, stop); });
  return result;
}

}  // namespace

void bind_rays(nb::module_& m, nb::class_<Scene>& scene) {
  nb::dict columns;  // of Met, as rows of numbers, where vectors begin
  columns["point"] = offsetof(Met, point) / sizeof(u32);
  columns["normal"] = offsetof(Met, normal) / sizeof(u32);
  m.attr("met_columns") = columns;
  scene.def("intersect", &nearest, "origins"_a, "directions"_a, "tree"_a = true, "isa"_a = "")
      .def("occluded", &any, "origins"_a, "directions"_a, "limits"_a, "tree"_a = true,
           "isa"_a = "");
  m.def("intersect_rays", &intersect_rays, "scene"_a, "n"_a, "origins"_a, "directions"_a,
        "limits"_a, "tree"_a, "isa"_a);
  m.def("occluded_rays", &occluded_rays, "scene"_a, "n"_a, "origins"_a, "directions"_a, "limits"_a,
        "tree"_a, "isa"_a);
}

}  // namespace parhelion
