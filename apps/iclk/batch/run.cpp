#include "apps/iclk/batch/run.h"

#include <chrono>
#include <new>

#include "apps/iclk/common/version.h"
#include "apps/iclk/session/report.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

Json error_body(const std::string& reason) {
  return {{"status", "error"}, {"reason", reason}, {"schema", kResultSchema}, {"version", version()}};
}

/// The pair alone, after the batch it was in threw: now the error is its own.
Json align_alone(const AlignPairs& align, const PairInput& pair, const std::string& where) {
  try {
    return align(std::span(&pair, 1)).front();
  } catch (const Error& e) {
    if (ends_the_run(e.code())) throw;
    return error_body(where + ": " + e.what());
  } catch (const std::bad_alloc&) {
    return error_body(where + ": not enough memory to align this pair; give a smaller --batch");
  } catch (const std::exception& e) {
    return error_body(where + ": internal error: " + e.what());
  }
}

std::vector<Json> align_group(const AlignPairs& align, std::span<const PairInput> pairs, std::span<const DecodedPair> items) {
  try {
    std::vector<Json> bodies = align(pairs);
    if (bodies.size() == pairs.size()) return bodies;
  } catch (const Error& e) {
    if (ends_the_run(e.code())) throw;
  } catch (const std::exception&) {
    // Below, pair by pair, it is caught again and named.
  }
  std::vector<Json> bodies;
  for (size_t i = 0; i < pairs.size(); ++i)
    bodies.push_back(align_alone(align, pairs[i], "line " + std::to_string(items[i].line->number)));
  return bodies;
}

/// Head first, then what the journal need not read: everything else in the order of the contract.
Json result_line(const DecodedPair& item, Json body) {
  Json line = result_head(*item.line, body["status"], item.inputs);
  if (body.contains("errors")) line["errors"] = body["errors"];
  for (auto it = body.begin(); it != body.end(); ++it)
    if (!line.contains(it.key())) line[it.key()] = std::move(it.value());
  if (!item.meta.is_null()) line["meta"] = item.meta;
  return line;
}

}  // namespace

bool ends_the_run(ErrorCode code) {
  switch (code) {
    case ErrorCode::device_lost:
    case ErrorCode::out_of_memory:
    case ErrorCode::vulkan:
    case ErrorCode::no_driver:
    case ErrorCode::no_device: return true;
    case ErrorCode::invalid_argument:
    case ErrorCode::unsupported:
    case ErrorCode::io: return false;
  }
  return true;
}

BatchOutcome run_batch(const BatchWork& work, ResultsJournal& journal, Tally& tally,
                       const std::function<void(const BatchOutcome&)>& progress) {
  const auto start = Clock::now();
  BatchOutcome outcome;
  DecodePool pool(work.lines, work.decode, work.limits, work.measure);
  PairGroup group;
  while (!pool.finished()) {
    if (work.stop()) {
      outcome.stopped = true;
      break;
    }
    pool.next(group, work.batch, std::chrono::milliseconds(100));
    std::vector<Json> bodies;
    if (!group.items.empty() && group.items.front().error.empty()) {
      std::vector<PairInput> pairs;
      for (DecodedPair& item : group.items) pairs.push_back(std::move(item.pair));
      try {
        bodies = align_group(work.align, pairs, group.items);
      } catch (const Error& e) {
        outcome.lost = e;
        break;
      }
    } else {
      for (DecodedPair& item : group.items) {
        bodies.push_back(error_body(item.error));
        if (work.inputs) item.inputs = work.inputs(*item.line).values;
      }
    }
    for (size_t i = 0; i < bodies.size(); ++i) {
      const Json line = result_line(group.items[i], std::move(bodies[i]));
      journal.append(line);
      tally.add(line);
      ++outcome.done;
      if (line["status"].get_ref<const std::string&>() == "error") {
        ++outcome.failed;
        work.failed(*group.items[i].line, line["reason"]);
      }
    }
    outcome.seconds = std::chrono::duration<double>(Clock::now() - start).count();
    progress(outcome);
  }
  pool.stop();
  journal.sync();
  outcome.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  return outcome;
}

}  // namespace iclk
