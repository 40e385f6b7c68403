// Sixteen paths side by side, and where they have met surfaces: by component, so that loops over
// all of them become vectors. What a lane holds whose path has ended means nothing, but loops go on
// computing with it: it is set from the start, and nothing is looked up by it.
#pragma once
#include "emitter.h"

namespace parhelion {

struct PathStats {
  u64 rays;
};

// What the first surface of a path looks like, and the parts of its radiance. Normalised units.
struct Features {
  float depth;  // distance from the camera
  Vec3 position, normal, shading_normal;
  Vec2 uv;
  Vec3 albedo, emission, direct;
  u32 shape, material;  // kNone: nothing was hit
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Where paths stand: the light gathered so far, and the ray that goes on.
struct Paths {
  Rows<Vec3, kBatch> origin, direction;  // of the ray; as in Ray, which the next two are, too
  Slot self[kBatch];
  u32 inward[kBatch];
  Slot slot[kBatch];  // what the ray hits, once it has been traced; its leaf is kNone for nothing
  float t[kBatch];    // and how far away
  Rows<Vec3, kBatch> sum, throughput;
  Rows<Receiver, kBatch> receiver;  // the vertex that the ray leaves
  float scatter_pdf[kBatch];        // of its direction; 0 if no light sample could have found it
  float eta_scale[kBatch];          // undoes the squeezing of radiance in glass, for the roulette
  float width[kBatch];      // of the cone around the ray that stands for its neighbours: at the
  float spread[kBatch];     // ray's origin, and what it grows by per unit of length
  float travelled[kBatch];  // from the camera
  u32 depth[kBatch];        // rays so far, the camera's own included
  u32 channel[kBatch];      // of red, green and blue the only one left, 0 to 2; kNone: any
  u32 holes[kBatch];        // passed by all rays so far
  SamplerBatch<kBatch> samplers;
  Media media[kBatch];

  PH_INLINE Ray ray(u32 k) const {
    return {origin.at(k), direction.at(k), self[k], inward[k] != 0};
  }
  PH_INLINE void set_ray(u32 k, const Ray& ray) {
    origin.set(k, ray.origin);
    direction.set(k, ray.direction);
    self[k] = ray.self;
    inward[k] = ray.inward;
  }
};

// The most parameters that a material's plain form may have (bsdf.h).
struct PlainBlock {
  float value[12];
};

// Where paths have met surfaces: what one step of a bounce hands on to the next.
struct Vertices {
  // As in Surface
  Rows<Vec3, kBatch> point, normal, shading;
  Rows<Vec2, kBatch> parameter;
  float error[kBatch];
  u32 inside_out[kBatch];
  u32 id[kBatch];
  const ShapeRecord* shape[kBatch];
  const MaterialRecord* material[kBatch];
  Vec3 color[kBatch];
  Vec2 uv[kBatch];
  Vec3 dpdu[kBatch], dpdv[kBatch];
  float uv_rate[kBatch];

  u32 front[kBatch];  // the surface is seen from its outside
  // What scatters: the surface's material or another that stands for it, and its parameters here,
  // which are the record's or `own`.
  const MaterialRecord* record[kBatch];
  const ParamBlock* block[kBatch];
  ParamBlock own[kBatch];
  Rows<PlainBlock, kBatch> plain;
  Rows<Frame, kBatch> frame;  // in which the surface scatters
  Rows<Vec3, kBatch> local_wo;
  Rows<Receiver, kBatch> receiver;

  // As in DirectSample
  Rows<Vec3, kBatch> to_light, radiance;
  float light_distance[kBatch], light_pdf[kBatch];
  u32 light_delta[kBatch];
  Slot light_slot[kBatch];
  Rows<Vec3, kBatch> local_wi;  // towards the light
  Rows<BsdfValue, kBatch> scattered;
  Rows<Vec3, kBatch> value;  // the light's radiance, scattered towards wo
  float scale[kBatch];       // its weight over its density

  PH_INLINE void set_surface(u32 k, const Surface& s) {
    point.set(k, s.point);
    normal.set(k, s.normal);
    shading.set(k, s.shading);
    parameter.set(k, s.parameter);
    error[k] = s.error;
    inside_out[k] = s.shape->inside_out;
    id[k] = s.id;
    shape[k] = s.shape;
    material[k] = s.material;
    color[k] = s.color;
    uv[k] = s.uv;
    dpdu[k] = s.dpdu, dpdv[k] = s.dpdv;
    uv_rate[k] = s.uv_rate;
  }
  PH_INLINE Surface surface(u32 k, Slot slot) const {
    return {point.at(k), normal.at(k), shading.at(k), parameter.at(k), error[k],
            slot,        id[k],        shape[k],      material[k],     color[k],
            uv[k],       dpdu[k],      dpdv[k],       uv_rate[k]};
  }
  PH_INLINE void set_light(u32 k, const DirectSample& s) {
    to_light.set(k, s.direction);
    radiance.set(k, s.radiance);
    light_distance[k] = s.distance;
    light_pdf[k] = s.pdf;
    light_delta[k] = s.delta;
    light_slot[k] = s.slot;
  }
};

}  // namespace parhelion::PH_ISA
