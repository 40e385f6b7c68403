// Where sixteen paths have met surfaces, by component as the paths are.
#pragma once
#include "../path.h"

namespace parhelion::PH_ISA {

// The most parameters that a material's plain form may have (bsdf.h).
struct PlainBlock {
  float value[16];
};

// The most that tables may have of a direction for such a form.
struct TableBlock {
  float value[4];
};

// What a material has prepared (bsdf.h), of which Layers are the most.
struct alignas(4) PreparedBlock {
  unsigned char bytes[288];

  template <class Prepared>
  PH_INLINE void set(const Prepared& prepared) {
    static_assert(sizeof(Prepared) <= sizeof(bytes) && alignof(Prepared) <= 4);
    compiler::copy(bytes, &prepared, sizeof(Prepared));
  }
  template <class Prepared>
  PH_INLINE const Prepared& as() const {
    return *reinterpret_cast<const Prepared*>(bytes);
  }
};

// The most numbers that a shape may have whose surfaces are found together.
struct PrimitiveBlock {
  float value[10];
};

// What materials in plain forms scatter at sixteen surfaces.
struct PlainSurfaces {
  Rows<PlainBlock, kBatch> plain;
  Rows<TableBlock, kBatch> from;  // what tables have of local_wo, of forms that need them
  Rows<Frame, kBatch> frame;      // in which the surface scatters
  Rows<Vec3, kBatch> local_wo, local_wi;
  Rows<BsdfValue, kBatch> scattered;
};

// Surfaces that paths have met, as in Surface, whatever scatters there.
struct MetSurfaces {
  Rows<Vec3, kBatch> point, normal, shading;
  Rows<Vec2, kBatch> parameter;
  float error[kBatch];
  u32 inside_out[kBatch];
  u32 id[kBatch];
  const ShapeRecord* shape[kBatch];
  const MaterialRecord* material[kBatch];
  Rows<Vec3, kBatch> color;
  Rows<Vec2, kBatch> uv;
  Rows<Vec3, kBatch> dpdu, dpdv;
  float uv_rate[kBatch];
  u32 front[kBatch];  // the surface is seen from its outside
};

// Where paths have met surfaces: what one step of a bounce hands on to the next.
struct Vertices : MetSurfaces, PlainSurfaces {
  Rows<PrimitiveBlock, kBatch> primitive;  // what has been met, of shapes that are found together
  u32 traits[kBatch];                      // the material's, then those of what scatters
  u32 parametrised;  // bits for those where uv and what comes of it may be other than 0
  // What scatters: the surface's material or another that stands for it, and its parameters here,
  // which are the record's or `own`, but for a primitive's own colour: `parameters` has that, too.
  const MaterialRecord* record[kBatch];
  const ParamBlock* block[kBatch];
  ParamBlock own[kBatch];
  // Bits for those that are of a blend, and those of them where it is its second material that
  // scatters; the share of the one that scatters, and the other one.
  u32 blended, second;
  float share[kBatch];
  const MaterialRecord* other[kBatch];
  Texel emission[kBatch];  // what the texture of what it gives off has here, if it has one
  Texel mapped[kBatch];    // and the map of its normals, if it has one
  PreparedBlock prepared[kBatch];
  Rows<Receiver, kBatch> receiver;
  u32 glossy;                         // bits for those that ask for light where they mirror it
  Rows<Highlight, kBatch> highlight;  // kNoHighlight for the others

  // Lights that are asked, where they are of these
  Rows<Triangle, kBatch> light_triangle;
  Rows<Sphere, kBatch> light_sphere;
  // As in DirectSample
  Rows<Vec3, kBatch> to_light, radiance;
  float light_distance[kBatch], light_pdf[kBatch];
  u32 light_delta[kBatch];
  Slot light_slot[kBatch];
  // Of the light's radiance, local_wi being towards it: what is scattered towards wo
  Rows<Vec3, kBatch> value;
  float scale[kBatch];         // its weight over its density
  Rows<Vec3, kBatch> through;  // what share of it gets here

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
    traits[k] = s.material->traits;
    color.set(k, s.color);
    uv.set(k, s.uv);
    dpdu.set(k, s.dpdu);
    dpdv.set(k, s.dpdv);
    uv_rate[k] = s.uv_rate;
  }
  PH_INLINE Surface surface(u32 k, Slot slot) const {
    return {point.at(k), normal.at(k), shading.at(k), parameter.at(k), error[k],
            slot,        id[k],        shape[k],      material[k],     color.at(k),
            uv.at(k),    dpdu.at(k),   dpdv.at(k),    uv_rate[k]};
  }
  // The parameters of what scatters.
  template <class Material>
  PH_INLINE Material parameters(u32 k) const {
    Material m = from_block<Material>(*block[k]);
    if (const Vec3 own_color = color.at(k); has_color(own_color)) set_first_color(m, own_color);
    return m;
  }
  PH_INLINE void set_blend(u32 k, const BlendChoice& choice) {
    if (choice.own == choice.other || !(choice.share < 1.0f)) return;
    blended |= 1u << k;
    second |= (choice.second ? 1u : 0u) << k;
    share[k] = choice.share;
    other[k] = choice.other;
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
