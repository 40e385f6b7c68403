// One sample's path, vertex by vertex, for people who want to know where its light comes from.
#pragma once
#include <vector>

#include "place.h"
#include "scene.h"

namespace parhelion {

// Light that was asked for at a vertex.
struct TracedLight {
  PrimitivePlace place;  // of an emissive primitive
  u32 record = kNone;    // else of the scene's lights, as scene.h sorts them
  Vec3 direction;
  double distance;  // user's units, infinite for what shines from outside
  float pdf;        // per steradian, with the choice of the light
  bool delta;       // without extent: pdf is the probability of its choice
  Vec3 radiance;    // as it leaves the light
  bool scattered;   // the material, or the other one of a blend, sends some on along the path
  double added[3];  // to the sample's radiance
};

enum class PathEvent : u32 { passes, reflects, transmits, ends };
enum class PathEnd : u32 {
  leaves,    // the scene
  deep,      // as many rays as a path may have
  back,      // of a material that has one side
  absorbed,  // the material sends nothing on
  dark,      // what goes on carries nothing
  roulette,  // ended by chance
  openness,  // ambient occlusion
  unseen,    // no ray of the camera's goes there
};

struct TracedVertex {
  PrimitivePlace place;
  u32 material;  // what scatters: of a blend one of its parts
  u32 depth;     // rays so far
  double position[3];
  double distance;  // of the ray that has come here
  Vec3 normal, shading_normal;
  bool front;         // met from outside
  double emitted[3];  // what the surface gives off, as it is added to the sample's radiance
  bool lit = false;   // light was asked for
  TracedLight light;
  PathEvent event = PathEvent::ends;
  bool specular = false;  // into one direction, without a density
  Vec3 direction;         // in which the path goes on
  float pdf = 0.0f;       // of that direction, per steradian
  Vec3 throughput;        // of the path from there on
};

// All numbers of light that was added are differences of the sum, so they add up to the radiance.
struct TracedPath {
  double origin[3];  // of the camera's ray
  Vec3 direction;
  std::vector<TracedVertex> vertices;
  PathEnd end = PathEnd::leaves;
  double background[3] = {};  // what is added where the path leaves the scene
  Vec3 radiance;              // that of Kernels::radiance
};

TracedPath trace_pixel(const Scene& scene, const RenderView& view, u32 x, u32 y, u32 sample);

}  // namespace parhelion
