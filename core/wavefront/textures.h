// What textures have where sixteen paths have met surfaces.
#pragma once
#include "../image_batch.h"
#include "wave.h"

namespace parhelion::PH_ISA {

// Looks textures up, images many at once.
class TexelQueue {
 public:
  PH_INLINE TexelQueue(const SceneView& scene, const Paths& paths, const Vertices& vertices)
      : scene_(scene), paths_(paths), vertices_(vertices) {}

  // Puts what a texture has where a path has met a surface into `to`, by the time that
  // `finish` has returned. width: of the footprint, in units of length.
  PH_INLINE void add(u32 texture, u32 k, float width, Texel& to) {
    const TextureRecord& record = scene_.textures.records[texture];
    if (!is_smooth_image(record)) {
      to = texel(scene_, texture, vertices_.surface(k, paths_.slot.at(k)), width);
      return;
    }
    const Image image = from_block<Image>(record.block);
    const TexturePoint own =
        own_point(record, {vertices_.uv.at(k), width * vertices_.uv_rate[k], {0, 0, 0}},
                  [](u32) { return Texel{{0, 0, 0}, 1}; });  // it takes no attribute for its uv
    images_.set(count_, scene_.textures.images[record.image], own.uv,
                filtered_width(image, own.width), static_cast<Wrap>(image.wrap_u),
                static_cast<Wrap>(image.wrap_v));
    to_[count_++] = &to;
    if (count_ == kBatch) finish();
  }

  PH_INLINE void finish() {
    if (count_ != 0) images_.look(count_, [&](u32 i, const Texel& t) { *to_[i] = t; });
    count_ = 0;
  }

 private:
  const SceneView& scene_;
  const Paths& paths_;
  const Vertices& vertices_;
  ImageBatch<kBatch> images_;
  Texel* to_[kBatch];
  u32 count_ = 0;
};

// The textures of what shines, on the sides that paths have met.
inline void find_emission(const SceneView& scene, const Paths& p, u32 lanes, Vertices& v) {
  const u32 textured = having(kShinesByTexture, v.traits, lanes);
  if (textured == 0) return;
  TexelQueue queue(scene, p, v);
  for_each_bit(textured, [&](u32 k) {
    const MaterialRecord& m = *v.material[k];
    if (emits_texture(m, v.front[k] != 0)) queue.add(m.emission_texture, k, 0.0f, v.emission[k]);
  });
  queue.finish();
}

// The parameters of materials, with the textures that stand for them here, and what maps of normals
// have.
inline void find_parameters(const SceneView& scene, const Paths& p, u32 lanes, Vertices& v) {
  const u32 textured = having(kTextured, v.traits, lanes);
  for_each_bit(lanes, [&](u32 k) { v.block[k] = &v.record[k]->block; });
  if (textured != 0) {
    Texel texel[kBatch][kBlockFloats];
    TexelQueue queue(scene, p, v);
    for_each_bit(textured, [&](u32 k) {
      const MaterialRecord& m = *v.record[k];
      u32 n = 0;  // at most one for each parameter
      for_each_texture(
          scene, m, [&](u32 texture) { queue.add(texture, k, p.width[k], texel[k][n++]); },
          [](const TextureBinding&) {});
      if (m.normal_map != kNone) queue.add(m.normal_map, k, p.width[k], v.mapped[k]);
    });
    queue.finish();
    for_each_bit(textured, [&](u32 k) {
      const MaterialRecord& m = *v.record[k];
      if (m.binding_count == 0) return;
      v.own[k] = m.block;
      v.block[k] = &v.own[k];
      u32 n = 0;
      for_each_texture(
          scene, m, [&](u32) { ++n; },
          [&](const TextureBinding& b) { put(v.own[k], b, texel[k][n - 1]); });
    });
  }
}

}  // namespace parhelion::PH_ISA
