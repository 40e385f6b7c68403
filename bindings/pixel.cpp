#include "pixel.h"

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "../host/trace_pixel.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace parhelion {
namespace {

const char* const kEvents[] = {"passes", "reflects", "transmits", "ends"};
const char* const kEnds[] = {"leaves", "deep",     "back",     "absorbed",
                             "dark",   "roulette", "openness", "unseen"};

nb::tuple triple(Vec3 v) { return nb::make_tuple(v.x, v.y, v.z); }
nb::tuple triple(const double (&v)[3]) { return nb::make_tuple(v[0], v[1], v[2]); }

nb::object index(u32 i) { return i == kNone ? nb::object(nb::none()) : nb::object(nb::int_(i)); }

nb::tuple place(const PrimitivePlace& p) {
  return nb::make_tuple(index(p.shape), index(p.primitive), index(p.instances), index(p.copy));
}

nb::dict light_dict(const Scene& scene, const TracedLight& light) {
  nb::dict d;
  d["place"] = place(light.place);
  d["name"] =
      light.record == kNone ? nb::object(nb::none()) : nb::cast(scene.light_names()[light.record]);
  d["direction"] = triple(light.direction);
  d["distance"] = light.distance;
  d["pdf"] = light.pdf;
  d["delta"] = light.delta;
  d["radiance"] = triple(light.radiance);
  d["scattered"] = light.scattered;
  d["added"] = triple(light.added);
  return d;
}

nb::dict traced(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample) {
  const TracedPath path = trace_pixel(scene, view, x, y, sample);
  nb::list vertices;
  for (const TracedVertex& v : path.vertices) {
    nb::dict d;
    d["place"] = place(v.place);
    d["material"] = v.material;
    d["depth"] = v.depth;
    d["position"] = triple(v.position);
    d["distance"] = v.distance;
    d["normal"] = triple(v.normal);
    d["shading_normal"] = triple(v.shading_normal);
    d["front"] = v.front;
    d["emitted"] = triple(v.emitted);
    d["light"] = v.lit ? nb::object(light_dict(scene, v.light)) : nb::object(nb::none());
    d["event"] = kEvents[static_cast<int>(v.event)];
    d["specular"] = v.specular;
    d["direction"] = triple(v.direction);
    d["pdf"] = v.pdf;
    d["throughput"] = triple(v.throughput);
    vertices.append(d);
  }
  nb::dict d;
  d["origin"] = triple(path.origin);
  d["direction"] = triple(path.direction);
  d["vertices"] = vertices;
  d["end"] = kEnds[static_cast<int>(path.end)];
  d["background"] = triple(path.background);
  d["radiance"] = triple(path.radiance);
  return d;
}

}  // namespace

void bind_pixel(nb::module_& m) {
  m.def("trace_pixel", &traced, "scene"_a, "view"_a, "x"_a, "y"_a, "sample"_a);
}

}  // namespace parhelion
