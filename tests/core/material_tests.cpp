// Tests of materials: that plain forms are the whole ones, and of distributions that answers are
// known of.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "../../core/material.h"
#include "check.h"
#include "cloud.h"

namespace {

using namespace parhelion;

// Even numbers that have chosen a lobe are even ones for its directions, in [0, 1).
void lobes_share_even_numbers() {
  for (const float chance : {0.0f, 1e-3f, 0.3f, 0.5f, 0.99f, 1.0f}) {
    const u32 n = 4096;
    float expected[2] = {0.0f, 0.0f}, widest = 0.0f;
    u32 count[2] = {0, 0};
    for (u32 i = 0; i < n; ++i) {
      Vec2 u = {(static_cast<float>(i) + 0.5f) / n, 0.25f};
      const u32 lobe = baseline::first_lobe(chance, 1.0f - chance, u) ? 0 : 1;
      const float step = 1.0f / (n * (lobe == 0 ? chance : 1.0f - chance));
      if (count[lobe]++ == 0) {
        CHECK(u.x <= step);
        expected[lobe] = u.x;
      }
      CHECK(u.x >= 0.0f && u.x < 1.0f && u.y == 0.25f);
      widest = std::max(widest, std::abs(u.x - expected[lobe]) / step);
      expected[lobe] += step;
    }
    CHECK(widest < 0.5f);
    CHECK(std::abs(static_cast<float>(count[0]) - n * chance) <= 1.0f);
  }
  // Nor does rounding make 1 of the largest.
  for (u32 i = 0; i <= 2000; ++i) {
    const float chance = static_cast<float>(i) / 2000.0f;
    for (const float x : {0.0f, 1.0f - 0x1p-24f}) {
      Vec2 u = {x, 0.0f};
      baseline::first_lobe(chance, 1.0f - chance, u);
      CHECK(u.x >= 0.0f && u.x < 1.0f);
    }
  }
}

template <class Form>
auto seen_from(const Form& form, Vec3 wo) {
  if constexpr (baseline::LooksThroughLayers<Form>) {
    return from(form, place_from(form, wo), layer_place_from(form, wo));
  } else {
    return from(form, place_from(form, wo));
  }
}
template <class Form>
auto whole_of(const Form& form, Vec3 wo) {
  if constexpr (baseline::LooksFrom<Form>) {
    return form.whole(seen_from(form, wo));
  } else {
    return form.whole();
  }
}
template <class Form>
baseline::BsdfValue value_plainly(const Form& form, Vec3 wo, Vec3 wi) {
  if constexpr (baseline::NeedsTables<Form>) {
    const auto seen = seen_from(form, wo);
    return evaluate(form, seen, to(form, place_to(form, wi)), wo, wi);
  } else {
    return value_of(whole_of(form, wo), wo, wi);
  }
}
template <class Form>
bool sample_plainly(const Form& form, Vec3 wo, const baseline::BsdfDraws& u,
                    baseline::BsdfSample& out) {
  if constexpr (baseline::NeedsTables<Form>) {
    const auto seen = seen_from(form, wo);
    baseline::PickedLobe lobe = pick(lobes(form, seen), u);
    if constexpr (requires { upper_part(form, seen); }) pick_upper(upper_part(form, seen), lobe);
    Vec3 wi;
    return choose(form, lobe, wo, wi) &&
           weigh_sample(form, seen, to(form, place_to(form, wi)), wo, wi, out);
  } else {
    return sample(whole_of(form, wo), wo, u, out);
  }
}

// What a material's plain form says is what the material says, to the bit.
template <class Material, class Form>
void plain_is_the_whole(const std::vector<ParamBlock>& blocks) {
  using namespace baseline;
  for (const ParamBlock& b : blocks) {
    const Material m = from_block<Material>(b);
    u32 fitting = 0;
    for_each_plain_form<Material>([&]<class Each>(u32) { fitting += Each::fits(m) ? 1 : 0; });
    CHECK(Form::fits(m) && fitting == 1);
    const Form form = Form::of(m);
    for (u32 i = 0; i < 2000; ++i) {
      const auto s = make_sampler(SamplerKind::independent, 1, 2, i, 9);
      Vec3 wo = uniform_sphere(draw2(s, 0)), wi = uniform_sphere(draw2(s, 1));
      Vec2 u = draw2(s, 2);
      if (i % 8 == 0) wo = normalize(Vec3{wo.x, wo.y, 1e-3f});
      if (i % 16 == 0) wi = normalize(Vec3{-wo.x, -wo.y, 1e-3f});
      if (i % 32 == 1) wo = normalize(Vec3{wo.x, wo.y, 0.0f});
      if (i % 32 == 2) wi = normalize(Vec3{wi.x, wi.y, 0.0f});
      if (i % 5 == 0) u.x = i % 2 == 0 ? 0.0f : 1.0f - 0x1p-24f;
      if (i % 7 == 0) u.y = i % 2 == 0 ? 0.0f : 1.0f - 0x1p-24f;
      const BsdfDraws draws = {u, draw1(s, 3)};
      BsdfSample one = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false}, other = one;
      const bool is = sample(m, wo, draws, one);
      CHECK(is == sample_plainly(form, wo, draws, other));
      CHECK(!is || std::memcmp(&one, &other, offsetof(BsdfSample, delta)) == 0);
      CHECK(!is || (one.delta == other.delta && finite(one.wi) && finite(one.weight)));
      const BsdfValue value = value_of(m, wo, wi), plainly = value_plainly(form, wo, wi);
      CHECK(finite(value.value) && finite(value.pdf));
      CHECK(std::memcmp(&value, &plainly, sizeof value) == 0);
    }
  }
}

// Plastic's blocks with what is worked out of them, which plain forms keep and whose values it does
// not change.
template <class Form>
std::vector<ParamBlock> derived(std::vector<ParamBlock> blocks) {
  using namespace baseline;
  const Vec3 wo = normalize(Vec3{0.3f, -0.4f, 0.5f}), wi = normalize(Vec3{0.1f, 0.7f, 0.2f});
  for (ParamBlock& b : blocks) {
    const Plastic one = from_block<Plastic>(b);
    Plastic other = one;
    derive(other);
    CHECK(one.inside == 0.0f && (other.inside > 0.0f || one.ior == 1.0f));
    CHECK(Form::of(other).whole().inside == other.inside);
    const BsdfValue u = value_of(one, wo, wi), v = value_of(other, wo, wi);
    CHECK(std::memcmp(&u, &v, sizeof u) == 0);
    other.ior += 0.25f;  // whoever changes one has it worked out anew
    derive(other);
    CHECK(other.inside == thrown_back(other, coat(other)));
    to_block(other, b);
  }
  return blocks;
}

void plain_materials_are_the_whole() {
  using namespace baseline;
  plain_is_the_whole<Diffuse, PlainDiffuse>(
      {block(MaterialKind::diffuse, {0.7f, 0.5f, 0.3f, 0.0f})});
  plain_is_the_whole<Diffuse, RoughDiffuse>({block(MaterialKind::diffuse, {0.7f, 0.5f, 0, 0.3f}),
                                             block(MaterialKind::diffuse, {1, 1, 0.9f, 1})});
  plain_is_the_whole<Metal, Metal>({block(MaterialKind::metal, {0.7f, 0.5f, 0.3f, 0.0f}),
                                    block(MaterialKind::metal, {0.7f, 0.5f, 0.3f, 0.4f}),
                                    block(MaterialKind::metal, {1.0f, 1.0f, 1.0f, 1.0f})});
  const auto metal = Cloud::metal;
  plain_is_the_whole<Conductor, Mirror>(
      {metal(0.0f, 0.0f, 0, 0), metal(0.0f, 0.5f, 1, 1), metal(0.01f, 0.0f, 0, 0)});
  plain_is_the_whole<Conductor, PlainConductor<Facets::ggx>>(
      {metal(0.3f, 0.0f, 0, 1), metal(0.9f, -0.7f, 0, 1), metal(0.0101f, 0.0f, 0, 1),
       metal(1.0f, 0.99f, 0, 1)});
  plain_is_the_whole<Conductor, PlainConductor<Facets::beckmann>>(
      {metal(0.3f, 0.0f, 1, 1), metal(0.9f, -0.7f, 1, 1), metal(0.0101f, 0.0f, 1, 1),
       metal(1.0f, 0.99f, 1, 1)});
  plain_is_the_whole<Conductor, CompensatedConductor<Facets::ggx, false>>(
      {metal(0.3f, 0.0f, 0, 0), metal(0.0101f, 0.0f, 0, 0), metal(1.0f, 0.0f, 0, 0)});
  plain_is_the_whole<Conductor, CompensatedConductor<Facets::beckmann, false>>(
      {metal(0.3f, 0.0f, 1, 0), metal(0.0101f, 0.0f, 1, 0), metal(1.0f, 0.0f, 1, 0)});
  plain_is_the_whole<Conductor, CompensatedConductor<Facets::ggx, true>>(
      {metal(0.3f, 0.1f, 0, 0), metal(0.02f, -0.6f, 0, 0), metal(1.0f, 0.99f, 0, 0)});
  plain_is_the_whole<Conductor, CompensatedConductor<Facets::beckmann, true>>(
      {metal(0.3f, 0.1f, 1, 0), metal(0.02f, -0.6f, 1, 0), metal(1.0f, 0.99f, 1, 0)});
  // What is brushed so little that nobody can tell takes tables of what is not.
  for_each_plain_form<Conductor>([&]<class Form>(u32) {
    CHECK(!Form::fits(from_block<Conductor>(metal(0.3f, 1e-4f, 0, 0))));
    CHECK(!Form::fits(from_block<Conductor>(metal(0.3f, 1e-4f, 1, 0))));
  });
  const auto principled = [](float metallic, float roughness, float ior, float specular) {
    Principled m{};
    m.color = {0.8f, 0.6f, 0.3f}, m.specular_color = {0.9f, 1.0f, 0.7f};
    m.metallic = metallic, m.roughness = roughness, m.ior = ior, m.specular = specular;
    m.clearcoat_roughness = 0.1f, m.clearcoat_ior = 1.5f, m.sheen_roughness = 0.5f;
    m.iridescence_ior = 1.3f, m.iridescence_thickness = 400.0f;
    return m;
  };
  const auto as_block = [](const Principled& m) {
    ParamBlock b = block(MaterialKind::principled, {});
    to_block(m, b);
    return b;
  };
  // The last two as within denser glass
  plain_is_the_whole<Principled, PlainPrincipled>(
      {as_block(principled(0.0f, 0.5f, 1.5f, 1)), as_block(principled(1.0f, 0.2f, 1.5f, 1)),
       as_block(principled(0.4f, 0.0f, 1.3f, 0.5f)), as_block(principled(0.9f, 1.0f, 1.0f, 0)),
       as_block(principled(0.0f, 0.5f, 0.625f, 1)), as_block(principled(0.4f, 0.3f, 0.98f, 1))});
  for (float Principled::* layer :
       {&Principled::transmission, &Principled::clearcoat, &Principled::iridescence,
        &Principled::anisotropy, &Principled::diffuse_roughness}) {
    Principled m = principled(0.5f, 0.5f, 1.5f, 1);
    m.*layer = 0.1f;
    CHECK(!PlainPrincipled::fits(m));
  }
  const auto layered = [&](float metallic, float coat, float coat_roughness, Vec3 sheen) {
    Principled m = principled(metallic, 0.5f, 1.5f, 1);
    m.clearcoat = coat, m.clearcoat_roughness = coat_roughness, m.sheen_color = sheen;
    return m;
  };
  const Principled velvet = layered(0.0f, 0.0f, 0.1f, {0, 0.1f, 0});
  CHECK(!PlainPrincipled::fits(velvet));
  Principled black = layered(0.0f, 1.0f, 0.3f, {0, 0, 0}), blacker = black;
  black.color = {0, 0, 0}, black.specular = 0.0f;
  blacker.color = blacker.specular_color = {0, 0, 0}, blacker.clearcoat_ior = 1.0f;
  plain_is_the_whole<Principled, LayeredPrincipled>(
      {as_block(velvet), as_block(layered(0.0f, 1.0f, 0.0f, {0, 0, 0})),
       as_block(layered(1.0f, 0.3f, 1.0f, {0, 0, 0})), as_block(layered(1.0f, 0.0f, 0, {1, 1, 1})),
       as_block(layered(0.4f, 0.7f, 0.2f, {1, 0.5f, 0.2f})), as_block(black), as_block(blacker)});
  for (float Principled::* layer : {&Principled::transmission, &Principled::iridescence,
                                    &Principled::anisotropy, &Principled::diffuse_roughness}) {
    Principled m = layered(0.5f, 0.5f, 0.1f, {0.5f, 0, 0});
    m.*layer = 0.1f;
    CHECK(!LayeredPrincipled::fits(m));
  }
  const auto brushed = [&](float roughness, float anisotropy, float rotation, float transmission) {
    Principled m = principled(1.0f, roughness, 1.5f, 1);
    m.anisotropy = anisotropy, m.anisotropy_rotation = rotation, m.transmission = transmission;
    return m;
  };
  Principled sooty = brushed(0.5f, 0.5f, 0, 0);
  sooty.color = {0, 0, 0};
  plain_is_the_whole<Principled, BrushedPrincipled>(
      {as_block(brushed(0.4f, 0.7f, 0, 0)), as_block(brushed(0.0f, -0.3f, 0, 0.5f)),
       as_block(brushed(1.0f, 0.99f, 0, 0)), as_block(sooty)});
  // Turned the way of a sample is, but for rounding, that of the whole.
  const Principled turned = brushed(0.4f, 0.7f, 30, 0);
  const BrushedPrincipled turned_form = BrushedPrincipled::of(turned);
  for (u32 i = 0; i < 2000; ++i) {
    const auto s = make_sampler(SamplerKind::independent, 1, 2, i, 9);
    const Vec3 wo = uniform_sphere(draw2(s, 0));
    BsdfSample one = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false}, other = one;
    const bool is = sample(turned, wo, {draw2(s, 1), 0.5f}, one);
    CHECK(is == sample_plainly(turned_form, wo, {draw2(s, 1), 0.5f}, other));
    if (!is) continue;
    const Vec3 off = one.wi - other.wi, heavier = one.weight - other.weight;
    CHECK(dot(off, off) < 1e-12f && dot(heavier, heavier) < 1e-8f);
    const float pdf = value_of(turned, wo, one.wi).pdf;
    CHECK(std::abs(one.pdf / pdf - 1.0f) < 1e-3f && std::abs(other.pdf / pdf - 1.0f) < 1e-3f);
  }
  const auto clear = [&](float roughness, float ior, float specular) {
    Principled m = principled(0.0f, roughness, ior, specular);
    m.transmission = 1.0f, m.diffuse_roughness = 0.5f;
    return m;
  };
  plain_is_the_whole<Principled, GlassPrincipled>(
      {as_block(clear(0.2f, 1.5f, 1)), as_block(clear(0.0f, 1.0f, 0.5f)),
       as_block(clear(1.0f, 2.5f, 0.1f)), as_block(clear(0.5f, 0.625f, 1))});
  for (float Principled::* layer : {&Principled::metallic, &Principled::clearcoat,
                                    &Principled::iridescence, &Principled::anisotropy}) {
    Principled m = clear(0.5f, 1.5f, 1);
    m.*layer = 0.1f;
    CHECK(!GlassPrincipled::fits(m));
    m = brushed(0.5f, 0.5f, 0, 0);
    m.*layer = layer == &Principled::anisotropy ? 0.0f : 0.1f;
    CHECK(!BrushedPrincipled::fits(m));
  }
  const auto plastic = [](float ior, float roughness, float nonlinear, float compensation,
                          float distribution = 0) {
    return block(MaterialKind::plastic, {0.8f, 0.0f, 0.3f, 1, 0.9f, 0.7f, ior, roughness,
                                         distribution, nonlinear, compensation});
  };
  const std::vector<ParamBlock> smooths = {plastic(1.49f, 0, 0, 0), plastic(2.5f, 0.01f, 1, 1),
                                           plastic(1.0f, 0, 0, 1)};
  const std::vector<ParamBlock> roughs = {plastic(1.49f, 0.3f, 0, 0), plastic(2.5f, 0.0101f, 1, 1),
                                          plastic(1.0f, 1, 0, 1)};
  const std::vector<ParamBlock> beckmanns = {
      plastic(1.49f, 0.3f, 0, 0, 1), plastic(2.5f, 0.0101f, 1, 1, 1), plastic(1.0f, 1, 0, 1, 1)};
  plain_is_the_whole<Plastic, SmoothPlastic>(smooths);
  plain_is_the_whole<Plastic, RoughPlastic<Facets::ggx>>(roughs);
  plain_is_the_whole<Plastic, RoughPlastic<Facets::beckmann>>(beckmanns);
  // What is worked out of a scene's plastic once is what is worked out anew each time.
  plain_is_the_whole<Plastic, SmoothPlastic>(derived<SmoothPlastic>(smooths));
  plain_is_the_whole<Plastic, RoughPlastic<Facets::ggx>>(
      derived<RoughPlastic<Facets::ggx>>(roughs));
  plain_is_the_whole<Plastic, RoughPlastic<Facets::beckmann>>(
      derived<RoughPlastic<Facets::beckmann>>(beckmanns));
  // By hand: straight down an index of 1.5 reflects 0.04, and its inside throws back 1 - (1 -
  // 0.0917765) / 2.25 = 0.596345 of diffuse light.
  const BsdfValue down = value_of(SmoothPlastic::of(from_block<Plastic>(plastic(1.5f, 0, 0, 0))),
                                  {0, 0, 1}, {0, 0, 1});
  const float base = 0.96f * 0.96f / (kPi * 2.25f * (1.0f - 0.596345f));
  CHECK(std::abs(down.value.x - 0.8f * base) < 1e-5f && down.value.y == 0.0f);
  plain_is_the_whole<ThinDielectric, ClearPane>(
      {block(MaterialKind::thin_dielectric, {1, 1, 1, 1.5f, 1, 1, 1, 1, 1, 1, 0}),
       block(MaterialKind::thin_dielectric,
             {0.9f, 0.8f, 1, 0.6f, 0.5f, 1, 0.7f, 1, 0.6f, 1, 0.005f})});
  const auto frosted_pane = [](float ior, float roughness) {
    return block(MaterialKind::thin_dielectric,
                 {0.9f, 0.8f, 1, ior, 0.5f, 1, 0.7f, 1, 0.6f, 1, roughness});
  };
  plain_is_the_whole<ThinDielectric, RoughPane>(
      {frosted_pane(1.5f, 0.0201f), frosted_pane(1.5f, 0.3f), frosted_pane(0.7f, 0.6f),
       frosted_pane(1.0f, 0.5f), frosted_pane(3.0f, 1.0f)});
  plain_is_the_whole<Dielectric, PlainDielectric>(
      {block(MaterialKind::dielectric, {1, 1, 1, 1.5f, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0}),
       block(MaterialKind::dielectric,
             {0.9f, 0.8f, 1, 0.6f, 0, 0.5f, 1, 1, 0.5f, 1, 1, 1, 1, 0.2f, 0.4f})});
  const auto glass = [](float ior, float roughness, float anisotropy, float distribution,
                        float compensation) {
    return block(MaterialKind::dielectric, {0.9f, 0.8f, 1, ior, roughness, anisotropy, distribution,
                                            compensation, 0.5f, 1, 0.7f, 1, 0.6f, 1, 0, 0.4f});
  };
  const auto frosted = [&](float distribution, float compensation) {
    const auto one = [&](float ior, float roughness, float anisotropy) {
      return glass(ior, roughness, anisotropy, distribution, compensation);
    };
    return std::vector<ParamBlock>{
        one(1.5f, 0.3f, 0),     one(0.6f, 1.0f, 0),  one(0.6f, 0.5f, 0),   one(2.5f, 0.0201f, 0),
        one(1.3f, 0.7f, -0.6f), one(1.02f, 0.9f, 0), one(1.3f, 0.7f, 0.6f)};
  };
  plain_is_the_whole<Dielectric, RoughDielectric<Facets::ggx>>(frosted(0, 1));
  plain_is_the_whole<Dielectric, RoughDielectric<Facets::beckmann>>(frosted(1, 1));
  plain_is_the_whole<Dielectric, CompensatedDielectric<Facets::ggx>>(frosted(0, 0));
  plain_is_the_whole<Dielectric, CompensatedDielectric<Facets::beckmann>>(frosted(1, 0));
  // What is as good as smooth is so on either side of it.
  for_each_plain_form<Dielectric>([&]<class Form>(u32) {
    CHECK(!Form::fits(from_block<Dielectric>(glass(1.5f, 0.01f, 0, 0, 1))));
    CHECK(!Form::fits(from_block<Dielectric>(glass(1.00001f, 0.9f, 0, 1, 1))));
  });
}

// How often mirrors are followed changes neither what comes back nor what densities say, but how
// many samples do.
void what_is_pulled_to_mirrors_is_as_bright() {
  double mirrored = 0.0;  // share of the samples
  const auto mean_weight = [&](const auto& m, Vec3 wo) {
    double sum = 0.0;
    mirrored = 0.0;
    constexpr int kSide = 512;
    for (int i = 0; i < kSide; ++i) {
      for (int j = 0; j < 16; ++j) {
        const float u = (static_cast<float>(i) + 0.5f) / kSide;
        baseline::BsdfSample s = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
        if (!sample(m, wo, {{u, (static_cast<float>(j) + 0.5f) / 16}, u}, s)) continue;
        sum += static_cast<double>(s.weight.y);
        mirrored += s.delta && s.wi.z * wo.z > 0.0f ? 1.0 / (kSide * 16) : 0.0;
        CHECK(s.delta || std::abs(value_of(m, wo, s.wi).pdf / s.pdf - 1.0f) < 1e-5f);
      }
    }
    return sum / (kSide * 16);
  };
  baseline::Plastic plastic = {{0.3f, 0.7f, 0.2f}, {0.9f, 0.8f, 1}, 1.6f, 0, 0, 1, 0, 0, 0};
  baseline::Dielectric glass = {{1, 1, 1}, 1.5f, 0, 0, 0, 0, {1, 0.9f, 1}, {1, 0.8f, 1}, 0, 0};
  for (float z : {1.0f, 0.7f, 0.3f, 0.05f, -0.9f, -0.5f}) {
    const Vec3 wo = {std::sqrt(1.0f - z * z), 0, z};
    const auto pulled_is_as_bright = [&](auto& m) {
      m.mirror_pull = 0.0f;
      const double mean = mean_weight(m, wo), share = mirrored;
      m.mirror_pull = 2.0f;
      CHECK(std::abs(mean_weight(m, wo) / mean - 1.0) < 3e-3);
      CHECK(std::abs(mirrored - 3.0 * share / (1.0 + 2.0 * share)) < 5e-3);
    };
    pulled_is_as_bright(plastic);
    pulled_is_as_bright(glass);
  }
}

// Of visible slopes of a Beckmann surface u is the share of those that are less.
void beckmann_slopes_follow_their_distribution() {
  for (int i = 1; i < 400; ++i) {
    const double angle = i < 300 ? i * 0.005235 : 1.5707963 - std::pow(10.0, -0.06 * (i - 300));
    const float cosine = static_cast<float>(std::cos(angle));
    const double c = static_cast<double>(cosine), s = std::sqrt(1.0 - c * c), k = 0.28209479177;
    const double all = std::erf(c / s), tail = std::exp(-c * c / (s * s));
    const double total = 0.5 * c * (1.0 + all) + s * k * tail;
    for (int j = 0; j < 300; ++j) {
      const double u = j < 200   ? j / 200.0
                       : j < 250 ? std::pow(10.0, -0.14 * (j - 199))
                                 : 1.0 - std::pow(10.0, -0.14 * (j - 249));
      const float at =
          baseline::visible_beckmann_slope(cosine, static_cast<float>(s), static_cast<float>(u));
      const double q = static_cast<double>(at);
      const double less = 0.5 * c * (std::erf(q) + all) + s * k * (tail - std::exp(-q * q));
      CHECK(std::abs(less / total - u) < 1e-6);
    }
  }
}

void probes_run() {
  const Cloud cloud(100);
  const Scene scene(input_of({cloud.group()}, Cloud::materials()));
  const Kernels& k = kernels();
  for (const ParamBlock& m : Cloud::materials()) {
    std::vector<BsdfProbe> probes(64);
    k.bsdf_sample(m, {0.6f, 0.0f, 0.8f}, SamplerKind::independent, 1, probes.size(), probes.data());
    for (const BsdfProbe& p : probes) {
      if (baseline::black(p.weight) || p.delta) continue;  // the first did not scatter
      Vec3 value;
      float pdf;
      k.bsdf_eval(m, {0.6f, 0.0f, 0.8f}, &p.wi, 1, &value, &pdf);
      CHECK(baseline::finite(value));
      CHECK(std::abs(pdf - p.pdf) <= 1e-5f * p.pdf);
    }
  }
  std::vector<LightProbe> lights(64);
  k.light_sample(scene.view(), {0.0f, 0.9f, 0.0f}, 1, lights.size(), lights.data());
  for (const LightProbe& l : lights) CHECK(l.pdf > 0.0f);
  const Scene empty(input_of({}, {}));
  const RenderView view = make_view(empty, 3, 3, SamplerKind::sobol);
  PathStats stats;
  CHECK(k.radiance(empty.view(), view, 1, 1, 0, stats).x == 1.0f);
}

}  // namespace

int main() {
  lobes_share_even_numbers();
  plain_materials_are_the_whole();
  what_is_pulled_to_mirrors_is_as_bright();
  beckmann_slopes_follow_their_distribution();
  probes_run();
  return finished("material");
}
