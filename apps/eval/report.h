#pragma once
#include <string>

#include "apps/eval/run.h"

namespace iclk {

/// What a person wants to know, a block an appearance: stages and baselines against the truth, the paper's means beside them;
/// then claims. Of more than three appearances only a line each.
std::string to_table(const EvalReport& report);

/// Everything that the table has, and the options. Every number is finite or null.
nlohmann::ordered_json to_json(const EvalReport& report);

/// One line a stage of a method of a sample: appearance,id,variant,method,stage,ran,e_pixel,e_transl,e_rot,start_e_pixel,
/// start_e_transl,start_e_rot,status,claimed,nees,ms. Empty: there is none.
std::string pairs_csv(const EvalReport& report);

/// The table: appearance,method,stage,pairs,ran, mean, median and p95 of each error, within_1px,within_3px, and of the last
/// stage claimed,wrong,nees,nees_median,inside_95,ms.
std::string rows_csv(const EvalReport& report);

/// The changes that were drawn, a line an image: {"appearance", "id", "variant", "side", "changes": [to_json(Change)]}. Empty
/// where nothing was.
std::string changes_jsonl(const EvalReport& report);

}  // namespace iclk
