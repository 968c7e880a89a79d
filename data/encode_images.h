// The pixels of a sample: part of data/encode.h.
#pragma once

#include "core/active_sites.h"
#include "data/encode.h"

namespace opaline {

/// Where the images of a sample go; null where not wanted. Each H x W x channels, or with sites, of one
/// image, sites x channels.
struct ImageOutputs {
  float* input = nullptr;      ///< always the whole image
  float* polarised = nullptr;  ///< 12 channels
  float* bsdf = nullptr;       ///< 12 channels
  const ActiveSites* sites = nullptr;
};

/// Only pixels that show light are computed: the object's for masked images. Throws Error naming the scene
/// where they were not all read.
void encode_images(const Scene& scene, const EncodeOptions& options, const Shot& shot,
                   const ImageOutputs& outputs);

}  // namespace opaline
