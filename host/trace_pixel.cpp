#include "trace_pixel.h"

#include <algorithm>

#include "../core/wavefront.h"

namespace parhelion {
namespace {

using namespace baseline;  // pictures are the same with every instruction set

// Watches the steps of one path.
class Recorder {
 public:
  Recorder(const SceneView& scene, const RenderView& view, TracedPath& path)
      : scene_(scene), view_(view), out_(path) {}

  void look(Step step, const PathState& path, const Vertex* v, Fate fate) {
    switch (step) {
      case Step::begins:
        copy(path.ray.origin - path.ray.direction * path.travelled, out_.origin);
        out_.direction = path.ray.direction;
        if (fate == Fate::ends) take(path, out_.background);
        break;
      case Step::leaves:
        take(path, out_.background);
        out_.end = PathEnd::leaves;
        break;
      case Step::meets: met(path, *v, fate); break;
      case Step::approaches: approached(path, *v, fate); break;
      case Step::asks: asked(*v); break;
      case Step::receives:
        if (last().lit) take(path, last().light.added);
        break;
      case Step::scatters: scattered(path, *v, fate); break;
    }
    incoming_ = path.ray.direction;
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
  Vec2 choice_{};

  TracedVertex& last() { return out_.vertices.back(); }

  void copy(Vec3 p, double (&to)[3]) const {
    const float own[3] = {p.x, p.y, p.z};
    for (int k = 0; k < 3; ++k) to[k] = static_cast<double>(own[k]) * scene_.unit;
  }

  // What has been added since it was last looked at.
  void take(const PathState& path, double (&added)[3]) {
    const float sum[3] = {path.sum.x, path.sum.y, path.sum.z};
    for (int k = 0; k < 3; ++k) {
      added[k] = static_cast<double>(sum[k]) - sum_[k];
      sum_[k] = static_cast<double>(sum[k]);
    }
  }

  PrimitivePlace place(Slot slot, u32 id) const {
    const ShapeRecord& shape = shape_of(scene_, id);
    PrimitivePlace p{static_cast<u32>(&shape - scene_.shapes), id - shape.first_id};
    if (slot.instance != kNone) {
      const Instance& instance = scene_.instances[slot.instance];
      p.instances = instance.shape;
      p.copy = instance.id - scene_.shapes[instance.shape].first_id;
    }
    return p;
  }

  void met(const PathState& path, const Vertex& v, Fate fate) {
    const Surface& s = v.surface;
    TracedVertex t{};
    t.place = place(s.slot, s.id);
    t.material =
        static_cast<u32>((fate == Fate::scatters ? v.record : s.material) - scene_.materials);
    t.depth = path.depth;
    copy(s.point, t.position);
    // The camera's own ray begins at the scene's bounds.
    const float length = out_.vertices.empty() ? path.travelled : path.hit.t;
    t.distance = static_cast<double>(length) * scene_.unit;
    t.normal = s.normal;
    t.shading_normal = s.shading;
    t.front = dot(incoming_, s.normal) < 0.0f;
    take(path, t.emitted);
    t.throughput = path.throughput;
    t.direction = path.ray.direction;
    if (fate == Fate::passes) t.event = PathEvent::passes;
    out_.vertices.push_back(t);
    if (fate != Fate::ends) return;
    out_.end = view_.integrator == Integrator::ambient_occlusion ? PathEnd::openness
               : path.depth >= view_.max_depth                   ? PathEnd::deep
                                                                 : PathEnd::back;
  }

  void approached(const PathState& path, const Vertex& v, Fate fate) {
    TracedVertex& t = last();
    t.shading_normal = v.frame.z;
    t.throughput = path.throughput;
    if (fate == Fate::passes) t.event = PathEvent::passes;
    if (fate == Fate::ends) out_.end = PathEnd::dark;
    if (fate != Fate::scatters) return;
    // The same draws once more, for what the steps do not hand on.
    Vertex own = v;
    own.place = 0;
    const Vertex* const here = &own;
    BounceDraws draws = {};
    draw_bounces(&path, &here, 1, true, draws);
    choice_ = {draws.choice[0][0], draws.choice[1][0]};
    next_ = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    sampled_ = with_material(v.block, [&](const auto& material) {
      return sample(material, v.local_wo, draws.bsdf(0), next_);
    });
  }

  void asked(const Vertex& v) {
    last().lit = true;
    TracedLight& light = last().light;
    const DirectSample& s = v.light;
    light.direction = s.direction;
    light.distance = static_cast<double>(s.distance) * scene_.unit;
    light.pdf = s.pdf;
    light.delta = s.delta;
    light.radiance = s.radiance;
    light.scattered = v.asks;
    if (s.slot.leaf != kNone) {
      const u32 id = with_primitive(scene_, s.slot, [](const auto&, u32 own) { return own; });
      light.place = place(s.slot, id);
    } else {
      light.record = pick_light(scene_, v.receiver, choice_).record;
    }
  }

  void scattered(const PathState& path, const Vertex& v, Fate fate) {
    TracedVertex& t = last();
    t.specular = sampled_ && next_.delta;
    t.pdf = sampled_ ? next_.pdf : 0.0f;
    t.throughput = path.throughput;
    if (fate != Fate::ends) {
      t.event = next_.wi.z * v.local_wo.z < 0.0f ? PathEvent::transmits : PathEvent::reflects;
      t.direction = path.ray.direction;
      return;
    }
    const Vec3 wi = renormalize(to_world(v.frame, next_.wi));
    const float survival = max_component(path.throughput) * path.eta_scale;
    out_.end = !sampled_ || !consistent(v.surface, -incoming_, wi, v.local_wo, next_.wi)
                   ? PathEnd::absorbed
               : !(survival > 0.0f) ? PathEnd::dark
                                    : PathEnd::roulette;
  }
};

}  // namespace

TracedPath trace_pixel(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample) {
  TracedPath path{};
  Recorder recorder(scene.view(), view, path);
  PathStats stats = {0};
  const auto watch = [&](Step step, const PathState& state, const Vertex* vertex, Fate fate) {
    recorder.look(step, state, vertex, fate);
  };
  CameraBatch<1> batch = {};
  batch.x[0] = x, batch.sample[0] = sample;
  begin_paths(scene.view(), view, y, batch);
  if (batch.sight[0] == Sight::nothing) path.end = PathEnd::unseen;
  path.radiance = radiance(scene.view(), view, x, y, sample, stats, watch);
  return path;
}

}  // namespace parhelion
