#include "data/loader.h"

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <map>
#include <mutex>
#include <numeric>
#include <stop_token>
#include <thread>

#include "core/error.h"
#include "core/random.h"

namespace opaline {
namespace {

/// Scenes kept in memory, first come, up to a bound.
class SceneCache {
 public:
  explicit SceneCache(int64_t max_bytes) : max_bytes_(max_bytes) {}

  std::shared_ptr<const Scene> find(int64_t index) {
    const std::lock_guard lock(mutex_);
    const auto found = scenes_.find(index);
    return found == scenes_.end() ? nullptr : found->second;
  }

  void offer(int64_t index, const std::shared_ptr<const Scene>& scene) {
    const int64_t bytes = scene->byte_size();
    const std::lock_guard lock(mutex_);
    if (bytes > max_bytes_ - held_ || !scenes_.emplace(index, scene).second) return;
    held_ += bytes;
  }

 private:
  std::mutex mutex_;
  std::map<int64_t, std::shared_ptr<const Scene>> scenes_;
  int64_t max_bytes_;
  int64_t held_ = 0;
};

/// A batch, or what stood in its way.
struct Outcome {
  Batch batch;
  std::exception_ptr error;
};

void check(const LoaderOptions& options) {
  if (options.batch < 1 || options.min_last < 1 || options.threads < 1 || options.prefetch < 1 ||
      options.epochs < 0 || options.max_samples < 0 || options.cache_bytes < 0) {
    fail_usage(
        "loader",
        "batch {}, min_last {}, threads {} and prefetch {} must be positive; epochs {}, max_samples {} "
        "and cache_bytes {} not negative",
        options.batch, options.min_last, options.threads, options.prefetch, options.epochs,
        options.max_samples, options.cache_bytes);
  }
}

}  // namespace

std::vector<int64_t> batch_sizes(int64_t samples, int64_t batch, int64_t min_last) {
  std::vector<int64_t> sizes(static_cast<size_t>(samples / batch), batch);
  const int64_t rest = samples % batch;
  if (rest == 0) return sizes;
  if (rest < min_last && !sizes.empty()) {
    sizes.back() += rest;
  } else {
    sizes.push_back(rest);
  }
  return sizes;
}

std::vector<int64_t> epoch_order(int64_t samples, uint64_t seed, int64_t epoch, bool shuffled) {
  std::vector<int64_t> order(static_cast<size_t>(samples));
  std::iota(order.begin(), order.end(), int64_t{0});
  if (shuffled) {
    Random random(seed, Purpose::kShuffle, static_cast<uint32_t>(epoch));
    shuffle(order, random);
  }
  return order;
}

struct Loader::Impl {
  Impl(std::shared_ptr<const Dataset> set, const LoaderOptions& chosen, LoaderPosition start)
      : dataset(std::move(set)), options(chosen), cache(chosen.cache_bytes) {
    check(options);
    samples = dataset->size(options.split);
    if (options.max_samples > 0) samples = std::min(samples, options.max_samples);
    if (samples == 0) {
      fail(dataset->facts().root.string(), "has no scenes in its {} split", to_string(options.split));
    }
    sizes = batch_sizes(samples, options.batch, options.min_last);
    offsets.assign(sizes.size(), 0);
    std::exclusive_scan(sizes.begin(), sizes.end(), offsets.begin(), int64_t{0});
    const auto per_epoch = static_cast<int64_t>(sizes.size());
    if (start.epoch < 0 || start.batch < 0 || start.batch > per_epoch) {
      fail_usage("loader", "cannot start at epoch {}, batch {}: an epoch has {} batches", start.epoch,
                 start.batch, per_epoch);
    }
    given = start.epoch * per_epoch + start.batch;
    claimed = given;
    end = options.epochs == 0 ? std::numeric_limits<int64_t>::max() : options.epochs * per_epoch;
    for (int i = 0; i < options.threads; ++i) {
      threads.emplace_back([this](const std::stop_token& stop) { work(stop); });
    }
  }

  /// Threads take the next batch that nobody has, as long as it is within the bound ahead of the consumer.
  void work(const std::stop_token& stop) {
    while (true) {
      int64_t number = 0;
      {
        std::unique_lock lock(mutex);
        const auto may_claim = [&] { return claimed < end && claimed - given < options.prefetch; };
        if (!room.wait(lock, stop, may_claim)) return;
        number = claimed++;
      }
      Outcome outcome = make(number, stop);
      {
        const std::lock_guard lock(mutex);
        ready.emplace(number, std::move(outcome));
      }
      filled.notify_all();
    }
  }

  Outcome make(int64_t number, const std::stop_token& stop) {
    Outcome outcome;
    try {
      const auto per_epoch = static_cast<int64_t>(sizes.size());
      const int64_t epoch = number / per_epoch;
      const auto index = static_cast<size_t>(number % per_epoch);
      const std::shared_ptr<const std::vector<int64_t>> order = order_of(epoch);
      std::vector<Sample> batch;
      for (int64_t i = 0; i < sizes[index] && !stop.stop_requested(); ++i) {
        batch.push_back(sample((*order)[static_cast<size_t>(offsets[index] + i)]));
      }
      if (batch.empty()) return outcome;  // only when stopped
      outcome.batch = make_batch(batch);
      outcome.batch.epoch = epoch;
      outcome.batch.index = static_cast<int64_t>(index);
    } catch (...) {
      outcome.error = std::current_exception();
    }
    return outcome;
  }

  Sample sample(int64_t index) {
    std::shared_ptr<const Scene> scene = options.cache_bytes > 0 ? cache.find(index) : nullptr;
    if (!scene) {
      const LoadOptions load{.bsdf = options.wanted.reconstruction, .truth = options.wanted.targets};
      try {
        scene = std::make_shared<const Scene>(dataset->load(options.split, index, load));
      } catch (const Error& e) {
        fail("loader", "scene {} ({}) cannot be used: {}", dataset->id(options.split, index),
             to_string(options.split), e.what());
      }
      if (options.cache_bytes > 0) cache.offer(index, scene);
    }
    return encode_scene(*scene, options.encode, options.wanted);
  }

  /// An epoch's order is made once: shuffling a large set for every batch would cost more than reading it.
  std::shared_ptr<const std::vector<int64_t>> order_of(int64_t epoch) {
    const std::lock_guard lock(order_mutex);
    auto& order = orders[epoch];
    if (!order) {
      order = std::make_shared<const std::vector<int64_t>>(
          epoch_order(samples, options.seed, epoch, options.shuffle));
    }
    const auto kept = order;
    while (orders.size() > 2) orders.erase(orders.begin());  // threads work on neighbouring batches
    return kept;
  }

  std::optional<Batch> next() {
    Outcome outcome;
    {
      std::unique_lock lock(mutex);
      if (given >= end) return std::nullopt;
      filled.wait(lock, [&] { return ready.contains(given); });
      const auto first = ready.find(given);
      if (first->second.error)
        std::rethrow_exception(first->second.error);  // stays: asking again says so again
      outcome = std::move(first->second);
      ready.erase(first);
      ++given;
    }
    room.notify_all();
    return std::move(outcome.batch);
  }

  std::shared_ptr<const Dataset> dataset;
  LoaderOptions options;
  SceneCache cache;
  int64_t samples = 0;
  std::vector<int64_t> sizes;    // of an epoch's batches
  std::vector<int64_t> offsets;  // of their first samples
  int64_t end = 0;               // number of the first batch not to give

  std::mutex order_mutex;
  std::map<int64_t, std::shared_ptr<const std::vector<int64_t>>> orders;

  // Batches are numbered from epoch 0 on. claimed - given never exceeds the prefetch bound.
  mutable std::mutex mutex;
  std::condition_variable_any room;
  std::condition_variable filled;
  std::map<int64_t, Outcome> ready;
  int64_t claimed = 0;
  int64_t given = 0;

  std::vector<std::jthread> threads;  // last: they stop and join before anything else is destroyed
};

Loader::Loader(std::shared_ptr<const Dataset> dataset, const LoaderOptions& options, LoaderPosition start)
    : impl_(std::make_unique<Impl>(std::move(dataset), options, start)) {}

Loader::~Loader() = default;

std::optional<Batch> Loader::next() {
  return impl_->next();
}

LoaderPosition Loader::position() const {
  const std::lock_guard lock(impl_->mutex);
  const int64_t per_epoch = batches_per_epoch();
  return {impl_->given / per_epoch, impl_->given % per_epoch};
}

int64_t Loader::batches_per_epoch() const {
  return static_cast<int64_t>(impl_->sizes.size());
}

int64_t Loader::samples() const {
  return impl_->samples;
}

}  // namespace opaline
