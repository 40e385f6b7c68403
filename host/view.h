// From a camera and settings in the user's terms to what the kernels see.
#pragma once
#include <string>

#include "../core/view.h"
#include "scene.h"

namespace parhelion {

// As in scene.py: user's units, angles in degrees. A field of view or height that is not given is
// 0, and with neither field of view the camera has its own; a focus distance of 0 means the
// target's.
struct CameraInput {
  double eye[3], target[3], up[3];
  double fov, vfov;
  double aperture_radius, focus_distance;
  std::string projection = "perspective";
  double height = 0.0;
  double shift[2] = {0.0, 0.0};
  bool mirrored = false;
};

// Throws SceneError for a camera without a meaning.
// bounds: of the scene, in normalised units; scale: those units per user's unit.
Camera make_camera(const CameraInput& input, u32 width, u32 height, double scale,
                   const Box& bounds);

// The bodies of glass or liquid that the camera is inside of.
Media media_around(const Scene& scene, const CameraInput& input, bool tree);

// radius 0 is the filter's own. Throws SceneError for an unknown name or a bad radius.
FilterTable make_filter(const std::string& name, double radius);

SamplerKind sampler_kind(const std::string& name);

}  // namespace parhelion
