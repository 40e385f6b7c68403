// Images of all directions, and how to sample them in proportion to their luminance.
//
// Latitude and longitude: rows are angles from +y, the first row's texels lying at the pole itself
// and the last row's at the other; columns go around from -z over +x, half a texel on. Between
// texel centres the image is bilinear. That is how Mitsuba lays its environments out. The cells of
// the distribution lie between four texel centres, their weight the mean luminance times the solid
// angle; within a cell the bilinear luminance is sampled exactly.
//
// Equal area: a square onto which the sphere is unfolded as an octahedron such that every texel
// takes the same solid angle; +z in its middle, -z in its corners. Texels are constant, each a cell
// of the distribution, as in pbrt-v4.
// Method: P. Clarberg, "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD", JGT 13(3), 2008.
#pragma once
#include "distribution.h"
#include "image.h"
#include "rows.h"

namespace parhelion::PH_ISA {

// Longitude and colatitude as shares of 2 pi and pi.
PH_INLINE Vec3 from_latlong(Vec2 p) {
  const CosSin longitude = cos_sin_turns(p.x), colatitude = cos_sin_turns(0.5f * p.y);
  return {longitude.s * colatitude.s, colatitude.c, -longitude.c * colatitude.s};
}
PH_INLINE Vec2 to_latlong(Vec3 d) {
  const float u = atan2(d.x, -d.z) * (0.5f / kPi);
  // From the tangent, because acos is blunt near the poles.
  const float v = atan2(sqrt(d.x * d.x + d.z * d.z), d.y) * (1.0f / kPi);
  return {u < 0.0f ? min(u + 1.0f, 1.0f) : u, v};
}

PH_INLINE Vec3 from_equal_area(Vec2 p) {
  const float u = 2.0f * p.x - 1.0f, v = 2.0f * p.y - 1.0f;
  const float a = abs(u), b = abs(v);
  const float above = 1.0f - (a + b);  // signed distance from the fold, where z is 0
  const float r = 1.0f - abs(above);
  const CosSin azimuth = cos_sin_turns(r > 0.0f ? 0.125f * ((b - a) / r + 1.0f) : 0.125f);
  const float size = r * safe_sqrt(2.0f - r * r);
  return {copysign(azimuth.c * size, u), copysign(azimuth.s * size, v),
          copysign(1.0f - r * r, above)};
}
PH_INLINE Vec2 to_equal_area(Vec3 d) {
  const float a = abs(d.x), b = abs(d.y), c = abs(d.z);
  // 1 - |z| from the sine where z is near 1.
  const float r = sqrt(min((a * a + b * b) / (1.0f + c), 1.0f));
  const float across = r * atan2(b, a) * (2.0f / kPi);
  float u = r - across, v = across;
  if (d.z < 0.0f) {
    const float swap = 1.0f - u;
    u = 1.0f - v;
    v = swap;
  }
  return {0.5f * (copysign(u, d.x) + 1.0f), 0.5f * (copysign(v, d.y) + 1.0f)};
}

// A cell of a latitude-longitude image, its four corners, and a place in it.
struct LatLongCell {
  u32 x, y;
  Vec2 place;
  Vec3 corner[2][2];  // by row and column
};

PH_INLINE u32 latlong_rows(const ImageView& image) {
  return image.height > 1 ? image.height - 1 : 1;
}

PH_INLINE u32 lower_row(const ImageView& image, u32 y) { return y + 1 < image.height ? y + 1 : y; }

PH_INLINE LatLongCell latlong_cell(const ImageView& image, u32 x, u32 y, Vec2 place) {
  const u32 right = x + 1 < image.width ? x + 1 : 0;
  const u32 lower = lower_row(image, y);
  return with_texels(image, [&](auto&& texel) -> LatLongCell {
    const auto at = [&](u32 i, u32 j) { return to_texel(texel(texel_number(image, 0, i, j))).rgb; };
    return {x, y, place, {{at(x, y), at(right, y)}, {at(x, lower), at(right, lower)}}};
  });
}

struct LatLongPlace {
  int x, y;    // of a cell
  Vec2 place;  // in it
};

// Without a branch, and by signed numbers, to and from which vectors have conversions. NaN is taken
// for 0.
PH_INLINE LatLongPlace latlong_place(u32 width, u32 rows, Vec3 direction) {
  const Vec2 p = to_latlong(direction);
  const float columns = static_cast<float>(static_cast<int>(width));
  const float left = p.x * columns - 0.5f;
  const float x = left < 0.0f ? left + columns : left;
  const float y = p.y * static_cast<float>(static_cast<int>(rows));
  const int column = static_cast<int>(max(x, 0.0f)), row = static_cast<int>(max(y, 0.0f));
  const int last_column = static_cast<int>(width) - 1, last_row = static_cast<int>(rows) - 1;
  const int i = column < last_column ? column : last_column, j = row < last_row ? row : last_row;
  return {i, j, {min(x - static_cast<float>(i), 1.0f), min(y - static_cast<float>(j), 1.0f)}};
}

PH_INLINE LatLongCell latlong_cell_at(const ImageView& image, Vec3 direction) {
  const LatLongPlace p = latlong_place(image.width, latlong_rows(image), direction);
  return latlong_cell(image, static_cast<u32>(p.x), static_cast<u32>(p.y), p.place);
}

PH_INLINE Vec3 latlong_color(const LatLongCell& c) {
  const Vec3 upper = c.corner[0][0] * (1.0f - c.place.x) + c.corner[0][1] * c.place.x;
  const Vec3 lower = c.corner[1][0] * (1.0f - c.place.x) + c.corner[1][1] * c.place.x;
  return upper * (1.0f - c.place.y) + lower * c.place.y;
}

// Mean luminance of a cell, by which the host weighs it, times 4.
PH_INLINE float latlong_weight(const LatLongCell& c) {
  return (luminance(c.corner[0][0]) + luminance(c.corner[0][1])) +
         (luminance(c.corner[1][0]) + luminance(c.corner[1][1]));
}

// Per steradian, of a place in a cell that is picked with the given probability.
PH_INLINE float latlong_pdf(u32 width, u32 rows, const LatLongCell& c, float probability) {
  const float sum = latlong_weight(c);
  const float relative = sum > 0.0f ? 4.0f * luminance(latlong_color(c)) / sum : 1.0f;
  const float height = static_cast<float>(rows);
  const float sine = cos_sin_turns(0.5f * ((static_cast<float>(c.y) + c.place.y) / height)).s;
  const float density =
      probability * relative * (static_cast<float>(width) * height) / (2.0f * kPi * kPi * sine);
  return sine > 0.0f ? density : 0.0f;
}

struct PanoramaSample {
  Vec3 direction;
  Vec3 color;
  float pdf;
};

// A place in a cell whose place is yet to be chosen, picked with `probability`. Without a branch: a
// loop over many becomes one of vectors.
PH_INLINE PanoramaSample sample_cell_of(u32 width, u32 rows, LatLongCell c, Vec2 u,
                                        float probability) {
  const float left = luminance(c.corner[0][0]) + luminance(c.corner[1][0]);
  const float right = luminance(c.corner[0][1]) + luminance(c.corner[1][1]);
  const float x = sample_linear(left, right, u.x);
  const float upper = luminance(c.corner[0][0]) * (1.0f - x) + luminance(c.corner[0][1]) * x;
  const float lower = luminance(c.corner[1][0]) * (1.0f - x) + luminance(c.corner[1][1]) * x;
  c.place = {x, sample_linear(upper, lower, u.y)};
  const float around = (static_cast<float>(c.x) + c.place.x + 0.5f) / static_cast<float>(width);
  const Vec2 p = {around < 1.0f ? around : around - 1.0f,
                  (static_cast<float>(c.y) + c.place.y) / static_cast<float>(rows)};
  return {from_latlong(p), latlong_color(c), latlong_pdf(width, rows, c, probability)};
}

PH_INLINE PanoramaSample sample_latlong(const ImageView& image, const Distribution& d, Vec2 u) {
  const CellSample s = sample_cell(d, u);
  const LatLongCell c = latlong_cell(image, s.x, s.y, {0.0f, 0.0f});
  return sample_cell_of(image.width, latlong_rows(image), c, s.u, s.probability);
}

// In a cell that has been picked.
PH_INLINE PanoramaSample equal_area_sample(const ImageView& image, const CellSample& s) {
  const float w = static_cast<float>(image.width), h = static_cast<float>(image.height);
  const Vec2 p = {(static_cast<float>(s.x) + s.u.x) / w, (static_cast<float>(s.y) + s.u.y) / h};
  return {from_equal_area(p), fetch(image, 0, s.x, s.y).rgb,
          s.probability * (w * h) / (4.0f * kPi)};
}
PH_INLINE PanoramaSample sample_equal_area(const ImageView& image, const Distribution& d, Vec2 u) {
  return equal_area_sample(image, sample_cell(d, u));
}

// Directions towards such images, many at once; those by latitude and longitude in a loop that
// compilers turn into vectors.
template <u32 kCount>
struct PanoramaBatch {
  const ImageView* image[kCount];
  const Distribution* distribution[kCount];
  bool latlong[kCount];
  Vec2 draws[kCount];
  CellSample cell[kCount];
  float corner[2][2][3][kCount];
  float direction[3][kCount], color[3][kCount], pdf[kCount];

  PH_INLINE void set(u32 i, const ImageView& panorama, const Distribution& d, bool by_latlong,
                     Vec2 u) {
    image[i] = &panorama, distribution[i] = &d, latlong[i] = by_latlong, draws[i] = u;
  }

  PH_INLINE void sample(u32 n) {
    sample_cells(distribution, draws, n, cell);
    for (u32 i = 0; i < n; ++i) {
      prefetch(*image[i], 0, cell[i].x, cell[i].y);
      if (latlong[i]) prefetch(*image[i], 0, cell[i].x, lower_row(*image[i], cell[i].y));
    }
    u32 width[kCount], rows[kCount], x[kCount], y[kCount];
    float u[2][kCount], probability[kCount];
    for (u32 i = 0; i < kCount; ++i) {
      LatLongCell c = {0, 0, {0, 0}, {}};
      width[i] = rows[i] = 1, u[0][i] = u[1][i] = probability[i] = 0.0f;
      if (i < n && latlong[i]) {
        width[i] = image[i]->width, rows[i] = latlong_rows(*image[i]);
        u[0][i] = cell[i].u.x, u[1][i] = cell[i].u.y, probability[i] = cell[i].probability;
        c = latlong_cell(*image[i], cell[i].x, cell[i].y, {0, 0});
      }
      x[i] = c.x, y[i] = c.y;
      for (int j = 0; j < 2; ++j) {
        for (int k = 0; k < 2; ++k) {
          const Vec3 v = c.corner[j][k];
          corner[j][k][0][i] = v.x, corner[j][k][1][i] = v.y, corner[j][k][2][i] = v.z;
        }
      }
    }
    for (u32 i = 0; i < kCount; ++i) {
      const auto at = [&](int j, int k) -> Vec3 {
        return {corner[j][k][0][i], corner[j][k][1][i], corner[j][k][2][i]};
      };
      const LatLongCell c = {x[i], y[i], {0, 0}, {{at(0, 0), at(0, 1)}, {at(1, 0), at(1, 1)}}};
      put(i, sample_cell_of(width[i], rows[i], c, {u[0][i], u[1][i]}, probability[i]));
    }
    for (u32 i = 0; i < n; ++i) {
      if (!latlong[i]) put(i, equal_area_sample(*image[i], cell[i]));
    }
  }

  PH_INLINE void put(u32 i, const PanoramaSample& s) {
    direction[0][i] = s.direction.x, direction[1][i] = s.direction.y;
    direction[2][i] = s.direction.z;
    color[0][i] = s.color.x, color[1][i] = s.color.y, color[2][i] = s.color.z;
    pdf[i] = s.pdf;
  }
  PH_INLINE PanoramaSample sampled(u32 i) const {
    return {{direction[0][i], direction[1][i], direction[2][i]},
            {color[0][i], color[1][i], color[2][i]},
            pdf[i]};
  }
};

// What an image by latitude and longitude has in some of many directions, in its own frame, and, of
// those that want it, the density of sampling it there.
template <u32 kCount>
struct PanoramaSights {
  struct Corners {
    Vec3 at[2][2];
  };

  Rows<Vec3, kCount> direction, color;
  float pdf[kCount] = {};
  int x[kCount], y[kCount];
  Rows<Vec2, kCount> place;
  Rows<Corners, kCount> corners = {};
  float probability[kCount] = {};

  PH_INLINE void look(const ImageView& image, const Distribution& d, u32 lanes, u32 weighed) {
    find(image.width, latlong_rows(image));
    // What memory is waited for is asked for all of them before any is looked at.
    for_each_bit(lanes, [&](u32 k) {
      const u32 i = static_cast<u32>(x[k]), j = static_cast<u32>(y[k]);
      prefetch(image, 0, i, j);
      prefetch(image, 0, i, lower_row(image, j));
    });
    for_each_bit(weighed, [&](u32 k) {
      compiler::prefetch(d.columns + row_of(d, static_cast<u32>(y[k])) + static_cast<u32>(x[k]));
    });
    for_each_bit(lanes, [&](u32 k) {
      const u32 i = static_cast<u32>(x[k]), j = static_cast<u32>(y[k]);
      const LatLongCell c = latlong_cell(image, i, j, {0.0f, 0.0f});
      corners.set(k, Corners{{{c.corner[0][0], c.corner[0][1]}, {c.corner[1][0], c.corner[1][1]}}});
    });
    for (u32 k = 0; k < kCount; ++k) color.set(k, latlong_color(cell(k)));
    if (weighed == 0) return;
    for_each_bit(weighed, [&](u32 k) {
      probability[k] = cell_probability(d, static_cast<u32>(x[k]), static_cast<u32>(y[k]));
    });
    weigh(image.width, latlong_rows(image));
  }

 private:
  PH_APART void find(u32 width, u32 rows) {
    for (u32 k = 0; k < kCount; ++k) {
      const LatLongPlace p = latlong_place(width, rows, direction.at(k));
      x[k] = p.x, y[k] = p.y;
      place.set(k, p.place);
    }
  }
  PH_INLINE LatLongCell cell(u32 k) const {
    const Corners c = corners.at(k);
    return {0,
            static_cast<u32>(y[k]),
            place.at(k),
            {{c.at[0][0], c.at[0][1]}, {c.at[1][0], c.at[1][1]}}};
  }
  PH_APART void weigh(u32 width, u32 rows) {
    for (u32 k = 0; k < kCount; ++k) pdf[k] = latlong_pdf(width, rows, cell(k), probability[k]);
  }
};

struct TexelPlace {
  u32 x, y;
};
PH_INLINE TexelPlace equal_area_texel(const ImageView& image, Vec3 direction) {
  const Vec2 p = to_equal_area(direction);
  const u32 x = static_cast<u32>(p.x * static_cast<float>(image.width));
  const u32 y = static_cast<u32>(p.y * static_cast<float>(image.height));
  return {x < image.width ? x : image.width - 1, y < image.height ? y : image.height - 1};
}

// What an image of all directions has in one of them.
PH_INLINE Vec3 panorama_color(const ImageView& image, bool latlong, Vec3 direction) {
  if (latlong) return latlong_color(latlong_cell_at(image, direction));
  const TexelPlace t = equal_area_texel(image, direction);
  return fetch(image, 0, t.x, t.y).rgb;
}

}  // namespace parhelion::PH_ISA
