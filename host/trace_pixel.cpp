#include "trace_pixel.h"

#include <algorithm>

#include "../core/wavefront.h"

namespace parhelion {
namespace {

using namespace PH_ISA;  // one of its own (CMakeLists.txt); pictures are the same with each

// Watches the steps of one path.
class Recorder {
 public:
  Recorder(const SceneView& scene, const RenderView& view, TracedPath& path)
      : scene_(scene), view_(view), out_(path) {}

  void look(Step step, const Paths& path, const Vertices* v, Fate fate, bool lit) {
    const Vec3 direction = path.direction.at(0);
    switch (step) {
      case Step::begins:
        copy(path.origin.at(0) - direction * path.travelled[0], out_.origin);
        out_.direction = direction;
        if (fate == Fate::ends) take(path, out_.background);
        break;
      case Step::leaves:
        take(path, out_.background);
        out_.end = PathEnd::leaves;
        break;
      case Step::meets: met(path, *v, fate); break;
      case Step::approaches: approached(path, *v, fate); break;
      case Step::asks: asked(*v, lit); break;
      case Step::receives:
        if (last().lit) take(path, last().light.added);
        break;
      case Step::scatters: scattered(path, *v, fate); break;
    }
    incoming_ = direction;
  }

 private:
  const SceneView& scene_;
  const RenderView& view_;
  TracedPath& out_;
  double sum_[3] = {};  // of the radiance so far
  Vec3 incoming_ = {};
  // Of the vertex: what will be drawn there, known before the path has gone on.
  BsdfSample next_{};
  bool sampled_ = false;
  double light_number_ = 0.0;  // of the vertex that is under way

  TracedVertex& last() { return out_.vertices.back(); }

  void copy(Vec3 p, double (&to)[3]) const {
    const float own[3] = {p.x, p.y, p.z};
    for (int k = 0; k < 3; ++k) to[k] = static_cast<double>(own[k]) * scene_.unit;
  }

  // What has been added since it was last looked at.
  void take(const Paths& path, double (&added)[3]) {
    const Vec3 all = path.sum.at(0);
    const float sum[3] = {all.x, all.y, all.z};
    for (int k = 0; k < 3; ++k) {
      added[k] = static_cast<double>(sum[k]) - sum_[k];
      sum_[k] = static_cast<double>(sum[k]);
    }
  }

  void met(const Paths& path, const Vertices& v, Fate fate) {
    const Surface s = v.surface(0, path.slot.at(0));
    TracedVertex t{};
    t.place = place_of(scene_, *s.shape, s.id, s.slot);
    t.material =
        static_cast<u32>((fate == Fate::scatters ? v.record[0] : s.material) - scene_.materials);
    t.depth = path.depth[0];
    copy(s.point, t.position);
    // The camera's own ray begins at the scene's bounds.
    const float length = out_.vertices.empty() ? path.travelled[0] : path.t[0];
    t.distance = static_cast<double>(length) * scene_.unit;
    t.normal = s.normal;
    t.shading_normal = s.shading;
    t.front = dot(incoming_, s.normal) < 0.0f;
    take(path, t.emitted);
    t.throughput = path.throughput.at(0);
    t.direction = path.direction.at(0);
    if (fate == Fate::passes) t.event = PathEvent::passes;
    out_.vertices.push_back(t);
    if (fate != Fate::ends) return;
    out_.end = view_.integrator == Integrator::ambient_occlusion ? PathEnd::openness
               : path.depth[0] >= view_.max_depth                ? PathEnd::deep
                                                                 : PathEnd::back;
  }

  void approached(const Paths& path, const Vertices& v, Fate fate) {
    TracedVertex& t = last();
    t.shading_normal = v.frame.at(0).z;
    t.throughput = path.throughput.at(0);
    if (fate == Fate::passes) t.event = PathEvent::passes;
    if (fate == Fate::ends) out_.end = PathEnd::dark;
    if (fate != Fate::scatters) return;
    // The same draws once more, for what the steps do not hand on.
    Paths own = path;
    Kinds kinds;
    kinds.lanes[v.block[0]->kind] = 1;
    BounceDraws draws = {};
    draw_bounces(own, kinds, true, draws);
    light_number_ = light_number(draws.point[0][0], draws.light[0]);
    next_ = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    sampled_ = with_material(*v.block[0], [&]<class Material>(const Material&) {
      Material material = v.parameters<Material>(0);
      pull_to_mirror(scene_, path.depth[0], material);
      return sample(material, v.local_wo.at(0), draws.bsdf(0), next_);
    });
  }

  void asked(const Vertices& v, bool lit) {
    last().lit = true;
    TracedLight& light = last().light;
    light.direction = v.to_light.at(0);
    light.distance = static_cast<double>(v.light_distance[0]) * scene_.unit;
    light.pdf = v.light_pdf[0];
    light.delta = v.light_delta[0] != 0;
    light.radiance = v.radiance.at(0);
    light.scattered = lit;
    const Slot slot = v.light_slot[0];
    if (slot.leaf != kNone) {
      const u32 id = with_primitive(scene_, slot, [](const auto&, u32 own) { return own; });
      light.place = place_of(scene_, shape_of(scene_, id), id, slot);
    } else {
      light.record = pick_light(scene_, v.receiver.at(0), v.highlight.at(0), light_number_).record;
    }
  }

  void scattered(const Paths& path, const Vertices& v, Fate fate) {
    TracedVertex& t = last();
    t.specular = sampled_ && next_.delta;
    t.pdf = sampled_ ? next_.pdf : 0.0f;
    t.throughput = path.throughput.at(0);
    const Vec3 local_wo = v.local_wo.at(0);
    if (fate != Fate::ends) {
      t.event = next_.wi.z * local_wo.z < 0.0f ? PathEvent::transmits : PathEvent::reflects;
      t.direction = path.direction.at(0);
      return;
    }
    const Vec3 wi = renormalize(to_world(v.frame.at(0), next_.wi));
    const float survival = max_component(path.throughput.at(0)) * path.eta_scale[0];
    out_.end = !sampled_ || !consistent(v.normal.at(0), -incoming_, wi, local_wo, next_.wi)
                   ? PathEnd::absorbed
               : !(survival > 0.0f) ? PathEnd::dark
                                    : PathEnd::roulette;
  }
};

}  // namespace

TracedPath trace_pixel(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample) {
  TracedPath path{};
  Recorder recorder(scene.view(), view, path);
  PathStats stats;
  const auto watch = [&](Step step, const Wave& wave, const Vertices* vertices, u32 /*lane*/,
                         Fate fate, bool lit = false) {
    recorder.look(step, wave.paths, vertices, fate, lit);
  };
  CameraBatch<1> batch = {};
  batch.x[0] = x, batch.y[0] = y, batch.sample[0] = sample;
  begin_paths(scene.view(), view, batch);
  if (batch.sight[0] == Sight::nothing) path.end = PathEnd::unseen;
  path.radiance = radiance(scene.view(), view, x, y, sample, stats, watch);
  return path;
}

}  // namespace parhelion
