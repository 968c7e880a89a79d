// Loads of a part of a vector, once an instruction set: include it after hwy/highway.h.
#include <hwy/highway.h>

#if defined(OPALINE_CORE_KERNELS_MASKED_LOAD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef OPALINE_CORE_KERNELS_MASKED_LOAD_INL_H_
#undef OPALINE_CORE_KERNELS_MASKED_LOAD_INL_H_
#else
#define OPALINE_CORE_KERNELS_MASKED_LOAD_INL_H_
#endif

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

/// The lanes of the mask from any address, zeros elsewhere. Instruction sets without masks read the whole
/// vector (the pool leaves room for that beyond an array); Highway would have it aligned for them.
template <class D, class M>
HWY_INLINE hwy::HWY_NAMESPACE::Vec<D> masked_load(M mask, D d, const hwy::HWY_NAMESPACE::TFromD<D>* from) {
#if HWY_TARGET <= HWY_AVX2
  return hwy::HWY_NAMESPACE::MaskedLoad(mask, d, from);
#else
  return hwy::HWY_NAMESPACE::IfThenElseZero(mask, hwy::HWY_NAMESPACE::LoadU(d, from));
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#endif
