// Streams batches from disk. Threads read and encode ahead of the consumer, a bounded number of batches; the
// order is a pure function of (seed, epoch), so nothing depends on threads, and a run may start anywhere.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "data/dataset.h"
#include "data/encode.h"

namespace opaline {

struct LoaderOptions {
  Split split = Split::kTrain;
  int64_t batch = 16;    ///< samples in a (micro-)batch
  int64_t min_last = 8;  ///< a smaller last batch of an epoch joins the one before; 1 keeps it
  bool shuffle = true;   ///< else in the order of the index
  uint64_t seed = 0;
  int64_t epochs = 0;       ///< end after this many, counted from epoch 0; 0: never
  int64_t max_samples = 0;  ///< use the first so many scenes of the split only; 0: all
  int threads = 1;          ///< that read and encode
  int64_t prefetch = 3;     ///< batches held ready at most
  int64_t cache_bytes = 0;  ///< decoded scenes kept in memory, first come; 0: none
  EncodeOptions encode = EncodeOptions::paper();
  EncodeWanted wanted;
};

/// The next batch to be given.
struct LoaderPosition {
  int64_t epoch = 0;
  int64_t batch = 0;
  bool operator==(const LoaderPosition&) const = default;
};

/// Sizes of an epoch's batches.
std::vector<int64_t> batch_sizes(int64_t samples, int64_t batch, int64_t min_last);

/// The scenes of an epoch, in order.
std::vector<int64_t> epoch_order(int64_t samples, uint64_t seed, int64_t epoch, bool shuffle);

class Loader {
 public:
  /// Throws Error where the split is empty, UsageError on sizes that make no sense.
  Loader(std::shared_ptr<const Dataset> dataset, const LoaderOptions& options, LoaderPosition start = {});
  /// Stops the threads; batches not taken are dropped.
  ~Loader();
  Loader(const Loader&) = delete;
  Loader& operator=(const Loader&) = delete;

  /// The next batch; nothing after the last epoch. What reading it threw is thrown here, naming the scene.
  std::optional<Batch> next();

  /// Of the batch that next() will give: what a checkpoint keeps.
  LoaderPosition position() const;
  int64_t batches_per_epoch() const;
  int64_t samples() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace opaline
