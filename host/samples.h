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

}  // namespace parhelion::PH_ISA
