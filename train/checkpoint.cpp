#include "train/checkpoint.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>
#include <system_error>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kPrefix = "step-";
constexpr std::string_view kTemporary = ".tmp-";
constexpr std::string_view kOptimizer = "optimizer.safetensors";
constexpr std::string_view kState = "state.json";
constexpr int kFormat = 1;

std::optional<int64_t> step_of(const fs::path& folder) {
  const std::string name = folder.filename().string();
  if (!name.starts_with(kPrefix)) return std::nullopt;
  int64_t step = 0;
  const char* const begin = name.data() + kPrefix.size();
  const char* const end = name.data() + name.size();
  const auto [last, error] = std::from_chars(begin, end, step);
  if (error != std::errc() || last != end || step < 0) return std::nullopt;
  return step;
}

void sync_folder(const fs::path& folder) {
  const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);  // not every file system lets a folder be synced; then the rename has to do
  ::close(descriptor);
}

std::string hash_file(const fs::path& path) {
  return to_hex(xxh64(read_file(path)));
}

std::string hash_text(std::string_view text) {
  return to_hex(xxh64(std::as_bytes(std::span(text))));
}

nlohmann::ordered_json to_json(const TrainingState& state) {
  return {{"stage", state.stage},
          {"epoch", state.epoch},
          {"batch", state.batch},
          {"step", state.step},
          {"stage_step", state.stage_step},
          {"log_lines", state.log_lines},
          {"epoch_sums", state.epoch_sums},
          {"config", state.config},
          {"data", state.data}};
}

TrainingState state_from_json(const nlohmann::ordered_json& json) {
  TrainingState state;
  json.at("stage").get_to(state.stage);
  json.at("epoch").get_to(state.epoch);
  json.at("batch").get_to(state.batch);
  json.at("step").get_to(state.step);
  json.at("stage_step").get_to(state.stage_step);
  json.at("log_lines").get_to(state.log_lines);
  json.at("epoch_sums").get_to(state.epoch_sums);
  json.at("config").get_to(state.config);
  json.at("data").get_to(state.data);
  return state;
}

/// The JSON with its own checksum as last key, as text.
std::string seal(nlohmann::ordered_json json) {
  json["xxh64"] = hash_text(json.dump());
  return json.dump(2) + "\n";
}

nlohmann::ordered_json unseal(const fs::path& path) {
  nlohmann::ordered_json json;
  try {
    const std::string text = read_text(path);
    json = nlohmann::ordered_json::parse(text);
    json.erase("xxh64");
    // Byte for byte, so that no digit of a number can change without notice.
    if (seal(json) != text) fail(path.string(), "its checksum does not fit: damaged");
    if (json.at("format").get<int>() != kFormat) {
      fail(path.string(), "has format {}, this program reads {}", json.at("format").dump(), kFormat);
    }
  } catch (const nlohmann::json::exception& error) {
    fail(path.string(), "is not a checkpoint's state: {}", error.what());
  }
  return json;
}

TensorMap load_checked(const fs::path& path, const std::string& expected_hash) {
  if (hash_file(path) != expected_hash) fail(path.string(), "its checksum does not fit: damaged");
  return load_safetensors(path).tensors;
}

}  // namespace

fs::path save_checkpoint(const fs::path& parent, const TrainingState& state, const Cascade& cascade,
                         const Adam& adam) {
  const std::string name = fmt::format("{}{}", kPrefix, state.step);
  const fs::path folder = parent / name;
  const fs::path temporary = parent / fmt::format("{}{}.{}", kTemporary, name, ::getpid());
  std::error_code error;
  fs::remove_all(temporary, error);
  fs::create_directories(temporary, error);
  if (error) fail(temporary.string(), "cannot make the folder: {}", error.message());
  try {
    nlohmann::ordered_json files;
    const auto write = [&](const std::string& file, const TensorMap& tensors) {
      save_safetensors(temporary / file, tensors);
      files[file] = hash_file(temporary / file);
    };
    for (const std::string& network : cascade.network_names()) {
      write(network + ".safetensors", cascade.network(network).state_dict());
    }
    write(std::string(kOptimizer), adam.state_dict());
    write_file_atomically(temporary / kState,
                          seal({{"format", kFormat}, {"state", to_json(state)}, {"files", files}}));
    sync_folder(temporary);
    // The same step can be there already: after a resume --from, or a replayed failure. The two change places
    // at once, so that a whole one has the name at any time.
    if (::renameat2(AT_FDCWD, temporary.c_str(), AT_FDCWD, folder.c_str(), RENAME_EXCHANGE) != 0) {
      if (errno != ENOENT) fs::remove_all(folder);  // a file system that cannot exchange
      fs::rename(temporary, folder);
    }
    sync_folder(parent);
    fs::remove_all(temporary, error);
  } catch (const std::exception& problem) {
    fs::remove_all(temporary, error);
    fail(folder.string(), "checkpoint not written, earlier ones are kept: {}", problem.what());
  }
  return folder;
}

std::vector<fs::path> list_checkpoints(const fs::path& parent) {
  std::vector<std::pair<int64_t, fs::path>> found;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(parent, error)) {
    const auto step = step_of(entry.path());
    if (step && entry.is_directory()) found.emplace_back(*step, entry.path());
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<fs::path> result;
  for (auto& [step, path] : found) result.push_back(std::move(path));
  return result;
}

void prune_checkpoints(const fs::path& parent, int64_t keep) {
  std::error_code error;
  const std::vector<fs::path> all = list_checkpoints(parent);
  for (size_t i = static_cast<size_t>(std::max<int64_t>(1, keep)); i < all.size(); ++i) {
    fs::remove_all(all[i], error);
  }
  std::vector<fs::path> leftovers;
  for (const fs::directory_entry& entry : fs::directory_iterator(parent, error)) {
    if (entry.path().filename().string().starts_with(kTemporary)) leftovers.push_back(entry.path());
  }
  for (const fs::path& leftover : leftovers) fs::remove_all(leftover, error);
}

Checkpoint load_checkpoint(const fs::path& folder, const LoadCheckpointOptions& options) {
  Checkpoint checkpoint;
  checkpoint.folder = folder;
  const nlohmann::ordered_json json = unseal(folder / kState);
  try {
    checkpoint.state = state_from_json(json.at("state"));
    for (const auto& [file, hash] : json.at("files").items()) {
      const fs::path path = folder / file;
      if (file == kOptimizer) {
        if (options.optimizer) checkpoint.optimizer = load_checked(path, hash.get<std::string>());
        continue;
      }
      const std::string network = fs::path(file).stem().string();
      const auto& wanted = options.networks;
      if (!wanted.empty() && std::find(wanted.begin(), wanted.end(), network) == wanted.end()) continue;
      checkpoint.networks[network] = load_checked(path, hash.get<std::string>());
    }
  } catch (const nlohmann::json::exception& error) {
    fail((folder / kState).string(), "is not a checkpoint's state: {}", error.what());
  }
  return checkpoint;
}

Checkpoint load_newest_checkpoint(const fs::path& parent, const Warn& warn,
                                  const LoadCheckpointOptions& options) {
  const std::vector<fs::path> all = list_checkpoints(parent);
  if (all.empty()) fail(parent.string(), "there is no checkpoint in this folder");
  for (const fs::path& folder : all) {
    try {
      return load_checkpoint(folder, options);
    } catch (const Error& error) {
      warn(fmt::format("checkpoint {} is passed over: {}", folder.filename().string(), error.what()));
    }
  }
  fail(parent.string(), "none of the {} checkpoints can be read", all.size());
}

void restore_networks(const Checkpoint& checkpoint, Cascade& cascade) {
  for (const auto& [name, tensors] : checkpoint.networks) {
    if (!cascade.has(name)) continue;
    cascade.network(name).load_state_dict(tensors,
                                          {.source = (checkpoint.folder / (name + ".safetensors")).string()});
  }
}

}  // namespace opaline
