// Rays against triangles or spheres by Embree 4, an array of them at a time: what rays.py calls.
// The library is that of embreex's wheel, which has no headers and whose own module knows no
// spheres, so what is needed of embree4/rtcore.h is declared here.
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#if defined(__SSE__)
#include <xmmintrin.h>
#endif

extern "C" {

struct RTCRay {
  float origin[3], near, direction[3], time, far;
  unsigned mask, id, flags;
};
// Longer than any version of 4 has it: ids of instances, of which there are none, come last.
struct alignas(16) RTCRayHit {
  RTCRay ray;
  float normal[3], u, v;
  unsigned primitive, geometry, instance[27];
};

static_assert(sizeof(RTCRay) == 48 && offsetof(RTCRayHit, geometry) == 72);

void* rtcNewDevice(const char* config);
void* rtcNewScene(void* device);
void* rtcNewGeometry(void* device, int type);
void* rtcSetNewGeometryBuffer(void* geometry, int buffer, unsigned slot, int format,
                              std::size_t stride, std::size_t count);
void rtcCommitGeometry(void* geometry);
unsigned rtcAttachGeometry(void* scene, void* geometry);
void rtcReleaseGeometry(void* geometry);
void rtcSetSceneFlags(void* scene, int flags);
void rtcCommitScene(void* scene);
void rtcReleaseScene(void* scene);
void rtcIntersect1(void* scene, RTCRayHit* ray, void* arguments);
void rtcOccluded1(void* scene, RTCRay* ray, void* arguments);

}  // extern "C"

namespace {

constexpr int kTriangles = 0, kSpheres = 50;                             // RTCGeometryType
constexpr int kIndices = 0, kVertices = 1;                               // RTCBufferType
constexpr int kThreeUnsigned = 0x5003, kThree = 0x9003, kFour = 0x9004;  // RTCFormat
constexpr int kRobust = 4;                                               // RTCSceneFlags

// Denormal numbers count as 0, as Embree's manual recommends.
class FlushDenormals {
#if defined(__SSE__)
 public:
  FlushDenormals() { _mm_setcsr(before_ | 0x8040); }
  ~FlushDenormals() { _mm_setcsr(before_); }

 private:
  const unsigned before_ = _mm_getcsr();
#endif
};

RTCRay ray_of(const float* origin, const float* direction) {
  RTCRay ray = {};
  std::memcpy(ray.origin, origin, sizeof(ray.origin));
  std::memcpy(ray.direction, direction, sizeof(ray.direction));
  ray.far = INFINITY;
  ray.mask = ~0u;
  return ray;
}

void fill(void* geometry, int buffer, int format, const void* from, std::size_t stride,
          std::size_t count) {
  void* to = rtcSetNewGeometryBuffer(geometry, buffer, 0, format, stride, count);
  if (!to) std::abort();
  std::memcpy(to, from, stride * count);
}

// What is one geometry, whose buffers fill_buffers makes. Built at Embree's default quality,
// medium. robust: few rays pass between neighbours, and numbers are exacter.
template <class Fill>
void* scene_of(int type, bool robust, Fill&& fill_buffers) {
  static void* const device = rtcNewDevice(nullptr);
  void* geometry = rtcNewGeometry(device, type);
  fill_buffers(geometry);
  rtcCommitGeometry(geometry);
  void* scene = rtcNewScene(device);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneFlags(scene, robust ? kRobust : 0);
  rtcCommitScene(scene);
  return scene;
}

}  // namespace

extern "C" {

// vertices: three floats each; faces: three numbers of vertices each.
void* embree_triangles(const float* vertices, std::size_t vertex_count, const unsigned* faces,
                       std::size_t face_count, bool robust) {
  return scene_of(kTriangles, robust, [&](void* geometry) {
    fill(geometry, kVertices, kThree, vertices, 3 * sizeof(float), vertex_count);
    fill(geometry, kIndices, kThreeUnsigned, faces, 3 * sizeof(unsigned), face_count);
  });
}

// Centre and radius each, four floats.
void* embree_spheres(const float* spheres, std::size_t count, bool robust) {
  return scene_of(kSpheres, robust, [&](void* geometry) {
    fill(geometry, kVertices, kFour, spheres, 4 * sizeof(float), count);
  });
}

void embree_release(void* scene) { rtcReleaseScene(scene); }

// origins and directions: three floats a ray. distances: infinite where nothing is hit.
void embree_nearest(void* scene, const float* origins, const float* directions, std::size_t count,
                    float* distances) {
  const FlushDenormals flush;
  for (std::size_t i = 0; i < count; ++i) {
    RTCRayHit hit;
    hit.ray = ray_of(origins + 3 * i, directions + 3 * i);
    hit.geometry = hit.instance[0] = ~0u;
    rtcIntersect1(scene, &hit, nullptr);
    distances[i] = hit.geometry == ~0u ? INFINITY : hit.ray.far;
  }
}

// hits: whether anything is, a byte a ray.
void embree_any(void* scene, const float* origins, const float* directions, std::size_t count,
                unsigned char* hits) {
  const FlushDenormals flush;
  for (std::size_t i = 0; i < count; ++i) {
    alignas(16) RTCRay ray = ray_of(origins + 3 * i, directions + 3 * i);
    rtcOccluded1(scene, &ray, nullptr);
    hits[i] = ray.far < 0.0f;
  }
}

}  // extern "C"
