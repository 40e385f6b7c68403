// What every material answers, in the local frame of the surface: z is the outward normal, wo
// points back to where the path came from, wi on to where light comes from.
//
// A material M, materials/NAME.h, has
//   a struct M whose members are its parameters in the order of M::params; the first is its colour,
//     which a primitive's own colour replaces
//   is_delta(m)             all of it is mirror-like: both of the next are 0
//   eval(m, wo, wi)         f |cos wi|
//   pdf(m, wo, wi)          density of sample, per steradian
//   evaluate(m, wo, wi)     instead of these both, as `value` and `pdf`, if that is cheaper
//   sample(m, wo, u, out)   false where the path ends
//   lobe_draws = true       if sample takes `lobe`, too
//   transmits = true        if light can pass: it is then asked for on both sides of the surface,
//                           else only for wo above it, whichever side is seen
//   is_opaque(m)            of a type that transmits, if some let no light pass
//   albedo(m)               for features, if the colour is not good enough
//   emitted(m)              radiance, only if it shines
//   float mirror_pull       behind its parameters, 0 in blocks, if it chooses by chance what to
//                           mirror: by how much the share that does is raised, 1 doubles it
//   derive(m)               fills other members behind its parameters, 0 in blocks, with what takes
//                           long to work out of parameters but the colour: once for a scene's
//                           material, unless textures stand for such parameters
//   prepare(m, wo)          a struct of what depends on m and wo alone, if that is much: then there
//                           are evaluate(m, prepared, wo, wi) and sample(m, prepared, wo, u, out)
//                           instead of those without it
//   Plain                   PlainForms<...>, if most surfaces of its kind need but few of its
//                           parameters: structs F of these. Where F::fits(m), sample and evaluate
//                           say the same of F::of(m) as of m, without branches: they become
//                           vectors for sixteen paths at once. Either
//     whole()               has sample and evaluate: F itself, or a material that has no branches
//                           once a compiler knows the parameters that F lacks; or, if tables have
//                           something of wo, whole(from), and From, FromPlace, place_from and from
//                           as below;
//                           or, if more of tables is needed than F::of looks up, there are
//     F::From, F::To        of floats: what tables have of wo, and of wi
//     F::FromPlace, F::ToPlace        of floats: where they have it
//     place_from(f, wo), place_to(f, wi)      find that, without branches
//     from(f, place), to(f, place)    look it up, for one path after the other
//     F::LayerPlace, layer_place_from(f, wo), from(f, place, layer_place)
//                           if there is more than compilers make vectors of in one loop
//     evaluate(f, from, to, wo, wi)
//     lobes(f, from)        the chances of two lobes
//     upper_part(f, from)   if the first is two, such as a coat and what it covers: the chance of
//                           the upper one among them
//     choose(f, lobe, wo, wi)         the direction of a sample of one; false where the path ends
//     gloss(f, wo), or, with tables, gloss(f, from, wo)      if it has any: Gloss (microfacet.h)
//     let_out(f, wo)        of an opaque form that scatters, but for a mirror image, by one factor
//                           of wo and another of wi: the former, of wo.z alone
//     opaque = true         of a type through which light can pass, if none passes this form
#pragma once
#include "entry.h"
#include "random.h"

namespace parhelion::PH_ISA {

// The numbers that sampling a material takes.
struct BsdfDraws {
  Vec2 direction;  // and, before it, which lobe scatters
  float lobe;      // which one does, if the direction has to be known first
};

// What is left of a number that chose a lobe, below 1: it goes to the direction, so those of either
// lobe are as even as all of them.
PH_INLINE float left_of_first(float chance, float u) { return min(u / chance, kBelowOne); }
PH_INLINE float left_of_other(float chance, float other, float u) {
  return min((u - chance) / other, kBelowOne);
}
// Whether the first of two lobes scatters, with such chances of either, whose sum is 1.
PH_INLINE bool first_lobe(float chance, float other, Vec2& u) {
  const bool first = u.x < chance;
  u.x = first ? left_of_first(chance, u.x) : left_of_other(chance, other, u.x);
  return first;
}

// Of materials with two lobes: the chances of either, and which one scatters, with what is left of
// the number.
struct LobeChances {
  float first, other;
};
struct PickedLobe {
  bool first;
  Vec2 number;
  bool upper;  // the upper one of the first, if that is two
  float lobe;  // as in BsdfDraws
};
PH_INLINE PickedLobe pick(LobeChances chances, BsdfDraws u) {
  const bool first = first_lobe(chances.first, chances.other, u.direction);
  return {first, u.direction, false, u.lobe};
}
// Of two that are the first, with the chance of the upper one among them.
PH_INLINE void pick_upper(float part, PickedLobe& lobe) {
  if (lobe.first) lobe.upper = first_lobe(part, 1.0f - part, lobe.number);
}

struct BsdfSample {
  Vec3 wi;
  Vec3 weight;  // f |cos| / pdf
  float pdf;    // 0 if delta
  float eta;    // index of the far side over the near side if the light passed through, else 1
  bool delta;
};

struct BsdfValue {
  Vec3 value;  // f |cos|
  float pdf;
};

template <class Material>
PH_INLINE BsdfValue value_of(const Material& m, Vec3 wo, Vec3 wi) {
  if constexpr (requires { evaluate(m, wo, wi); }) {
    const auto both = evaluate(m, wo, wi);
    return {both.value, both.pdf};
  } else {
    return {eval(m, wo, wi), pdf(m, wo, wi)};
  }
}

template <class Material>
concept Prepares = requires(const Material& m) { prepare(m, Vec3{}); };

template <Prepares Material, class Prepared>
PH_INLINE BsdfValue value_of(const Material& m, const Prepared& prepared, Vec3 wo, Vec3 wi) {
  const auto both = evaluate(m, prepared, wo, wi);
  return {both.value, both.pdf};
}
template <Prepares Material>
PH_INLINE auto evaluate(const Material& m, Vec3 wo, Vec3 wi) {
  return evaluate(m, prepare(m, wo), wo, wi);
}
template <Prepares Material>
PH_INLINE bool sample(const Material& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  return sample(m, prepare(m, wo), wo, u, out);
}

// The forms in which materials of a type may be plain.
template <class... Form>
struct PlainForms {};

inline constexpr u32 kMostPlainForms = 7;

// Calls f.operator()<Form>(number) for each form in which a type of materials may be plain.
template <class... Form, class F>
PH_INLINE void for_each_form(PlainForms<Form...>, F&& f) {
  static_assert(sizeof...(Form) <= kMostPlainForms);
  u32 number = 0;
  (f.template operator()<Form>(number++), ...);
}
template <class Material, class F>
PH_INLINE void for_each_plain_form(F&& f) {
  if constexpr (requires { typename Material::Plain; }) {
    for_each_form(typename Material::Plain{}, f);
  }
}

// Forms that need what tables have of wo, and those that need it of wi, too.
template <class Form>
concept LooksFrom = requires { typename Form::From; };
template <class Form>
concept NeedsTables = LooksFrom<Form> && requires { typename Form::To; };
template <class Form>
concept LooksThroughLayers = LooksFrom<Form> && requires { typename Form::LayerPlace; };

// Forms that tell how much of what they scatter is gloss.
template <class Form>
concept HasGloss =
    requires(const Form& form, Vec3 wo) { gloss(form, wo); } ||
    requires(const Form& form, const typename Form::From& seen, Vec3 wo) { gloss(form, seen, wo); };

// A sample of a form that needs tables, once its direction has been chosen.
template <NeedsTables Form>
PH_INLINE bool weigh_sample(const Form& m, const typename Form::From& seen,
                            const typename Form::To& to, Vec3 wo, Vec3 wi, BsdfSample& out) {
  const BsdfValue v = evaluate(m, seen, to, wo, wi);
  out.wi = wi;
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  return v.pdf > 0.0f;
}

template <class Material>
PH_INLINE Vec3 emitted(const Material&) {
  return {0, 0, 0};
}

}  // namespace parhelion::PH_ISA
