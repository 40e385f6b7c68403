// Which samples kernels render, and where what these have seen goes. No standard header here:
// kernels.cpp includes it.
#pragma once
#include "kernel_table.h"

namespace parhelion::PH_ISA {

inline void record(FeaturePixel& pixel, const Features& f, u32 sample) {
  if (sample == 0) {
    pixel.shape = f.shape;
    pixel.material = f.material;
  }
  ++pixel.count;
  const float light[kLightFloats] = {f.albedo.x,   f.albedo.y,   f.albedo.z,
                                     f.emission.x, f.emission.y, f.emission.z,
                                     f.direct.x,   f.direct.y,   f.direct.z};
  for (u32 i = 0; i < kLightFloats; ++i) {
    if (finite(light[i])) add(pixel.light[i], light[i]);
  }
  if (f.shape == kNone) return;
  ++pixel.hits;
  add(pixel.shapes, f.shape);
  add(pixel.materials, f.material);
  const Vec3 n = f.normal, m = f.shading_normal, p = f.position;
  const float place[kPlaceFloats] = {f.depth, p.x, p.y, p.z, n.x,    n.y,
                                     n.z,     m.x, m.y, m.z, f.uv.x, f.uv.y};
  for (u32 i = 0; i < kPlaceFloats; ++i) {
    if (finite(place[i])) add(pixel.place[i], place[i]);
  }
}

// Samples that have ended, on their way into the film.
struct Finished {
  FilmPixel* pixels;
  u32 at[kBatch] = {}, count = 0;
  float rgb[3][kBatch] = {};

  void take(u32 pixel, Vec3 light) {
    at[count] = pixel;
    rgb[0][count] = light.x, rgb[1][count] = light.y, rgb[2][count] = light.z;
    if (++count == kBatch) add_all();
  }
  void add_all() {
    add(pixels, at, rgb, count);
    count = 0;
  }
};

// Some samples of a run of a row's pixels, pixel after pixel.
class RowSamples {
 public:
  RowSamples(u32 row, u32 begin, u32 end, u32 from, u32 to, FilmPixel* film, FeaturePixel* seen)
      : y_(row), x0_(begin), x1_(end), first_(from), last_(to), features_(seen), finished_{film} {
    x_ = from < to ? begin : end;
    sample_ = from;
  }

  // The next samples of a batch, and a number for each by which it is told again; how many.
  u32 next(CameraBatch<kBatch>& batch, u32 (&tag)[kBatch]) {
    u32 n = 0;
    for (; n < kBatch && x_ < x1_; ++n) {
      batch.x[n] = x_, batch.y[n] = y_, batch.sample[n] = sample_;
      tag[n] = x_ - x0_;
      if (++sample_ == last_) ++x_, sample_ = first_;
    }
    return n;
  }
  // One of them has ended.
  void end(u32 tag, Vec3 light) { finished_.take(tag, light); }
  void see(const CameraBatch<kBatch>& batch, u32 i, const Features& seen) {
    record(features_[batch.x[i] - x0_], seen, batch.sample[i]);
  }
  bool sees() const { return features_ != nullptr; }
  PathGroup* groups() { return nullptr; }
  void finish() {
    finished_.add_all();
    for (u32 i = 0; i < x1_ - x0_; ++i) {
      carry(finished_.pixels[i]);
      if (features_) carry(features_[i]);
    }
  }

 private:
  u32 y_, x0_, x1_, first_, last_, x_, sample_;
  FeaturePixel* features_;
  Finished finished_;
};

// The pixels of a region, in groups whose paths are shared: those of even rows and those of odd
// ones apart, as they decide for each other how many samples they get (render.h). Which are in a
// group is left to chance, again after some samples, so that what they have in common neither lies
// side by side nor stays with the same.
PH_INLINE u32 pixel_in_region(u64 key, u32 parity, u32 number) {
  static_assert(kRegion == 16, "below are seven bits for the pixels of rows of one parity");
  u32 i = number;
  for (u32 round = 0; round < 3; ++round) {
    i = (i * static_cast<u32>(key >> (16 * round) & 0xfe) + i +
         static_cast<u32>(key >> (16 * round + 8))) &
        127;
    i ^= i >> 3;
  }
  return (i / kRegion * 2 + parity) * kRegion + i % kRegion;
}

// Samples of a region's pixels, of each from one number to another; the others of their groups come
// with them, and are left out of the film. The groups of sixteen pixels begin for some samples
// together, so that the camera's rays are batches of one pixel's.
class RegionSamples {
 public:
  RegionSamples(const SceneView& scene, const RenderView& view, const Region& region,
                PathStats& stats)
      : scene_(scene), view_(view), region_(region), stats_(stats), finished_{region.pixels} {
    first_ = kNone, last_ = 0;
    for (u32 i = 0; i < kRegionPixels; ++i) {
      if (region.from[i] >= region.to[i]) continue;
      first_ = region.from[i] < first_ ? region.from[i] : first_;
      last_ = region.to[i] > last_ ? region.to[i] : last_;
    }
    sample_ = first_;
    for (u32 g = 0; g < kPool; ++g) free_[g] = g;
  }

  u32 next(CameraBatch<kBatch>& batch, u32 (&tag)[kBatch]) {
    u32 n = 0;
    while (n < kBatch) {
      if (begun_ == 0 && !next_groups()) break;
      const u32 index = current_[turn_];
      const PathGroup& g = pool_[index];
      batch.x[n] = g.x[member_], batch.y[n] = g.y[member_], batch.sample[n] = g.sample;
      tag[n++] = index * kReused + member_;
      if (++turn_ < begun_) continue;
      turn_ = 0;
      if (++member_ == g.count) begun_ = 0;
    }
    return n;
  }
  void end(u32 tag, Vec3 light) {
    PathGroup& g = pool_[tag / kReused];
    if (!leave_group(g, tag % kReused, light)) return;
    Vec3 radiance[kReused];
    share_out(scene_, view_, g, radiance, stats_);
    for (u32 i = 0; i < g.count; ++i) {
      if (wanted(g.x[i], g.y[i], g.sample)) finished_.take(place(g.x[i], g.y[i]), radiance[i]);
    }
    free_[free_count_++] = tag / kReused;
  }
  void see(const CameraBatch<kBatch>& batch, u32 i, const Features& seen) {
    if (!wanted(batch.x[i], batch.y[i], batch.sample[i])) return;
    record(region_.features[place(batch.x[i], batch.y[i])], seen, batch.sample[i]);
  }
  bool sees() const { return region_.features != nullptr; }
  PathGroup* groups() { return pool_; }
  void finish() {
    finished_.add_all();
    for (u32 i = 0; i < kRegionPixels; ++i) {
      if (region_.from[i] >= region_.to[i]) continue;
      const u32 at = place(region_.x + i % kRegion, region_.y + i / kRegion);
      carry(region_.pixels[at]);
      if (region_.features) carry(region_.features[at]);
    }
  }

 private:
  // Each group that has begun has a path among the lanes of two waves, but for those to begin.
  static constexpr u32 kPool = 2 * kBatch + kRegionSamples;
  static constexpr u32 kGroups = kRegionPixels / kReused;

  bool wanted(u32 x, u32 y, u32 sample) const {
    const u32 i = (y - region_.y) * kRegion + (x - region_.x);
    return region_.from[i] <= sample && sample < region_.to[i];
  }
  u32 place(u32 x, u32 y) const { return (y - region_.y0) * region_.stride + (x - region_.x0); }

  // Begins the next groups of which a sample is wanted.
  bool next_groups() {
    for (; sample_ < last_; sample_ = end_of_turn(), number_ = 0) {
      while (number_ < kGroups) {
        const u32 number = number_++;
        for (u32 sample = sample_, end = end_of_turn(); sample < end; ++sample) {
          const u32 group = free_[--free_count_];
          if (fill(pool_[group], number, sample)) {
            current_[begun_++] = group;
          } else {
            free_[free_count_++] = group;
          }
        }
        member_ = turn_ = 0;
        if (begun_ != 0) return true;
      }
    }
    return false;
  }
  u32 end_of_turn() const {
    const u32 end = (sample_ / kRegionSamples + 1) * kRegionSamples;
    return end < last_ ? end : last_;
  }
  // Makes a group of its pixels; whether any of them wants the sample.
  bool fill(PathGroup& g, u32 number, u32 sample) const {
    const u64 place = static_cast<u64>(region_.y) << 32 | region_.x;
    const u64 key = mix(mix(place) + view_.seed + sample / kRegionSamples);
    const u32 parity = number % 2, first = number / 2 * kReused;
    g.clear();
    g.sample = sample;
    bool any = false;
    for (u32 m = 0; m < kReused; ++m) {
      const u32 i = pixel_in_region(key, parity, first + m);
      const u32 x = region_.x + i % kRegion, y = region_.y + i / kRegion;
      if (x >= view_.width || y >= view_.height) continue;
      g.x[g.count] = x, g.y[g.count] = y;
      ++g.count;
      any |= wanted(x, y, sample);
    }
    g.going = g.count;
    return any;
  }

  const SceneView& scene_;
  const RenderView& view_;
  const Region& region_;
  PathStats& stats_;
  Finished finished_;
  PathGroup pool_[kPool] = {};
  u32 free_[kPool], free_count_ = kPool;
  u32 first_, last_, sample_, number_ = 0;
  // Groups whose samples are given next, pixel after pixel: sixteen at most, or none.
  u32 current_[kRegionSamples], begun_ = 0, member_ = 0, turn_ = 0;
};

}  // namespace parhelion::PH_ISA
