// Rendering: tiles over OpenMP threads, added to a film in an order that does not matter.
#pragma once
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "kernels.h"
#include "scene.h"

namespace parhelion {

// Pairs of id and coverage that a pixel keeps of a Cryptomatte, the specification's suggestion.
inline constexpr size_t kMatteRanks = 6;

// The sums of a rectangle of the picture. x, y: its top left pixel within the whole picture.
struct Film {
  u32 x, y, width, height;
  std::vector<FilmPixel> pixels;
  std::vector<FeaturePixel> features;  // as many, or none

  Film(u32 x, u32 y, u32 width, u32 height, bool with_features);
  // Means, (height, width, 3). A pixel without samples is black.
  void means(float* rgb) const;
  // Cryptomatte's ranks, (height, width, kMatteRanks, 2): ids[index], as the bits of a float, and
  // the share of the samples that saw it, the largest first, equal ones by id; zeros where there
  // are no more. Indices with the same id are one. Throws std::out_of_range for an index without an
  // id.
  void ranks(Tally FeaturePixel::* tally, std::span<const u32> ids, float* out) const;
};

enum class Schedule { dynamic_, static_, guided };

struct RenderOptions {
  int threads = 1;
  u32 tile = 16;  // edge of a tile, in pixels
  Schedule schedule = Schedule::dynamic_;
};

struct PassResult {
  u64 samples = 0, rays = 0;
  bool complete = true;  // false if `tick` stopped it
};

// Called now and then by the calling thread with what the pass has done so far; true stops it.
using Tick = std::function<bool(u64 samples, u64 rays)>;

// Adds samples [first, last) of every pixel of the film.
PassResult render_pass(const Kernels& kernels, const Scene& scene, const RenderView& view,
                       Film& film, u32 first, u32 last, const RenderOptions& options,
                       const Tick& tick);

// Lets go of OpenMP's threads, which do not survive a fork.
void release_threads();

}  // namespace parhelion
