#include "data/loader.h"

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <map>
#include <mutex>
#include <numeric>
#include <stop_token>
#include <thread>
#include <utility>

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
  if (options.rank < 0 || options.rank >= options.ranks) {
    fail_usage("loader", "rank {} of {}: ranks count from 0", options.rank, options.ranks);
  }
}

/// The batches of an epoch, or of the rest of one.
struct EpochPlan {
  std::vector<int64_t> sizes;
  std::vector<int64_t> offsets;  ///< of their first samples in the epoch's order

  EpochPlan() = default;
  EpochPlan(int64_t first, int64_t samples, const LoaderOptions& options)
      : sizes(batch_sizes(samples, options.batch, options.min_last, options.ranks)), offsets(sizes.size()) {
    std::exclusive_scan(sizes.begin(), sizes.end(), offsets.begin(), first);
  }
  int64_t batches(const LoaderOptions& options) const {
    return static_cast<int64_t>(sizes.size()) / options.ranks;
  }
};

}  // namespace

std::vector<int64_t> batch_sizes(int64_t samples, int64_t batch, int64_t min_last, int64_t ranks) {
  if (samples == 0) return {};
  const int64_t round = batch * ranks;
  std::vector<int64_t> sizes(static_cast<size_t>(samples / round * ranks), batch);
  int64_t rest = samples % round;
  if (rest == 0) return sizes;
  if (rest / ranks < min_last && !sizes.empty()) {
    sizes.resize(sizes.size() - static_cast<size_t>(ranks));
    rest += round;
  }
  if (rest < ranks) fail("loader", "{} scenes are too few for {} ranks", samples, ranks);
  for (int64_t rank = 0; rank < ranks; ++rank) sizes.push_back(rest / ranks + (rank < rest % ranks ? 1 : 0));
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
    first_epoch = start.epoch;
    first_batch = start.batch;
    every = EpochPlan(0, samples, options);
    const auto per_epoch = static_cast<int64_t>(every.sizes.size());
    const bool done = start.batch == per_epoch;
    // Batches before the end of an epoch are full, whatever the number of ranks.
    const int64_t taken = done ? samples : start.batch * options.batch;
    if (start.epoch < 0 || start.batch < 0 || taken > samples ||
        (start.batch > 0 && taken == samples && !done)) {
      fail_usage("loader", "cannot start at epoch {}, batch {}: an epoch has {} batches", start.epoch,
                 start.batch, per_epoch);
    }
    first = EpochPlan(taken, samples - taken, options);
    const int64_t left = options.epochs - start.epoch - 1;  // epochs after this one
    end = options.epochs == 0 ? std::numeric_limits<int64_t>::max()
          : left < 0          ? 0
                              : first.batches(options) + left * every.batches(options);
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

  /// The position of this rank's batch of a number.
  LoaderPosition position_of(int64_t number) const {
    const int64_t in_first = first.batches(options);
    if (number < in_first) return {first_epoch, first_batch + number * options.ranks};
    const int64_t per_epoch = every.batches(options);
    const int64_t later = number - in_first;
    return {first_epoch + 1 + later / per_epoch, later % per_epoch * options.ranks};
  }

  Outcome make(int64_t number, const std::stop_token& stop) {
    Outcome outcome;
    try {
      const LoaderPosition at = position_of(number);
      const bool begun = at.epoch == first_epoch;
      const EpochPlan& plan = begun ? first : every;
      const auto in_plan = static_cast<size_t>(at.batch - (begun ? first_batch : 0) + options.rank);
      const std::shared_ptr<const std::vector<int64_t>> order = order_of(at.epoch);
      BatchBuilder builder(plan.sizes[in_plan], options.encode, options.wanted);
      std::vector<ReplacedScene> replaced;
      for (int64_t i = 0; i < plan.sizes[in_plan]; ++i) {
        if (stop.stop_requested()) return outcome;
        const auto [index, scene] = readable_scene(*order, plan.offsets[in_plan] + i, i, replaced);
        builder.add(*scene, draw_shot(options.capture, options.seed, at.epoch, index, scene->flash));
      }
      outcome.batch = builder.take();
      outcome.batch.epoch = at.epoch;
      outcome.batch.index = at.batch + options.rank;
      outcome.batch.replaced = std::move(replaced);
    } catch (...) {
      outcome.error = std::current_exception();
    }
    return outcome;
  }

  /// The scene at a place of the order or, where damage may be skipped, the first after it that can be read.
  std::pair<int64_t, std::shared_ptr<const Scene>> readable_scene(const std::vector<int64_t>& order,
                                                                  int64_t place, int64_t sample,
                                                                  std::vector<ReplacedScene>& replaced) {
    const int64_t index = order[static_cast<size_t>(place)];
    if (options.damaged == DamagePolicy::kFail) return {index, load(index)};
    std::string first_problem;
    for (int64_t step = 0; step < samples; ++step) {
      const int64_t candidate = order[static_cast<size_t>((place + step) % samples)];
      std::string problem = known_damage(candidate);
      if (problem.empty()) {
        try {
          auto scene = load(candidate);
          if (step > 0) replaced.push_back({sample, dataset->id(options.split, index), first_problem});
          return {candidate, std::move(scene)};
        } catch (const UsageError&) {
          throw;
        } catch (const Error& e) {
          problem = e.what();
          const std::lock_guard lock(damage_mutex);
          damage.emplace(candidate, problem);
        }
      }
      if (step == 0) first_problem = problem;
    }
    fail("loader", "none of {} scenes can be used; the first problem: {}", samples, first_problem);
  }

  std::string known_damage(int64_t index) {
    const std::lock_guard lock(damage_mutex);
    const auto found = damage.find(index);
    return found == damage.end() ? std::string() : found->second;
  }

  std::shared_ptr<const Scene> load(int64_t index) {
    if (options.cache_bytes > 0) {
      if (auto scene = cache.find(index)) return scene;
    }
    const LoadOptions wanted{.bsdf = options.wanted.reconstruction,
                             .truth = options.wanted.targets,
                             .whole = needs_whole_image(options.encode, options.wanted),
                             .support = options.wanted.support};
    std::shared_ptr<const Scene> scene;
    try {
      scene = std::make_shared<const Scene>(dataset->load(options.split, index, wanted));
    } catch (const Error& e) {
      fail("loader", "scene {} ({}) cannot be used: {}", dataset->id(options.split, index),
           to_string(options.split), e.what());
    }
    if (options.cache_bytes > 0) cache.offer(index, scene);
    return scene;
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
      const auto entry = ready.find(given);
      if (entry->second.error)
        std::rethrow_exception(entry->second.error);  // stays: asking again says so again
      outcome = std::move(entry->second);
      ready.erase(entry);
      ++given;
    }
    room.notify_all();
    return std::move(outcome.batch);
  }

  std::shared_ptr<const Dataset> dataset;
  LoaderOptions options;
  SceneCache cache;
  int64_t samples = 0;
  int64_t first_epoch = 0;  // where it starts
  int64_t first_batch = 0;
  EpochPlan first;  // the rest of the epoch it starts in
  EpochPlan every;  // each epoch after
  int64_t end = 0;  // number of the first batch not to give

  std::mutex damage_mutex;
  std::map<int64_t, std::string> damage;  // scenes that could not be read, and why

  std::mutex order_mutex;
  std::map<int64_t, std::shared_ptr<const std::vector<int64_t>>> orders;

  // This rank's batches are numbered from the start on. claimed - given never exceeds the prefetch bound.
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
  return impl_->position_of(impl_->given);
}

int64_t Loader::batches_per_epoch() const {
  return impl_->every.batches(impl_->options);
}

int64_t Loader::samples() const {
  return impl_->samples;
}

}  // namespace opaline
