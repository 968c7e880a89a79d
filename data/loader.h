// Streams batches from disk. Threads read and encode ahead of the consumer, a bounded number of batches; the
// order is a pure function of (seed, epoch), so nothing depends on threads, and a run may start anywhere.
// Only what the inputs need is read. Memory: the batches held ready, the scenes that threads work on, the
// cache, and 16 bytes a scene for the order of up to two epochs.
//
// Ranks. An epoch's order is cut into batches as if one rank took them all; rank r of R takes batches r, r +
// R, .. so that together they take the whole epoch, in the same order whatever R is. Only the end is shared
// anew: what does not fill a batch for every rank is split evenly, and every rank has the same number of
// batches.
//
// Damage. Under DamagePolicy::kSkip the next scene of the epoch's order that can be read stands in for one
// that cannot. Batches keep their sizes, epochs their steps, and the choice depends on the files alone: a
// resumed run makes the same one.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "data/dataset.h"
#include "data/encode.h"

namespace opaline {

/// What a scene that cannot be read does: end the run, or be named, counted and replaced.
enum class DamagePolicy { kFail, kSkip };

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
  int64_t rank = 0;
  int64_t ranks = 1;
  DamagePolicy damaged = DamagePolicy::kFail;
  CaptureOptions capture = {};  ///< drawn anew for every scene in every epoch; the cache holds clean scenes
  EncodeOptions encode = EncodeOptions::paper();
  EncodeWanted wanted = {};
};

/// The next batch to be given. Holds for any number of ranks.
struct LoaderPosition {
  int64_t epoch = 0;
  int64_t batch = 0;  ///< batches of the epoch that all ranks together have taken
  bool operator==(const LoaderPosition&) const = default;
};

/// Sizes of an epoch's batches, in its order; rank r has those at r, r + ranks, ... Throws Error where there
/// are fewer samples than ranks.
std::vector<int64_t> batch_sizes(int64_t samples, int64_t batch, int64_t min_last, int64_t ranks = 1);

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
  /// Of this rank.
  int64_t batches_per_epoch() const;
  int64_t samples() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace opaline
