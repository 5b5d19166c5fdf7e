#include "arithmetic.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <set>
#include <string_view>

namespace iclk::test {
namespace {

// Of the SPIR-V specification, 3.49 and GLSL.std.450.
enum Op : uint32_t {
  kExtInstImport = 11,
  kExtInst = 12,
  kTypeBool = 20,
  kTypeFloat = 22,
  kTypeVector = 23,
  kConstant = 43,
  kConstantComposite = 44,
  kFunction = 54,
  kDecorate = 71,
  kCompositeConstruct = 80,
  kCompositeExtract = 81,
  kFAdd = 129,
  kFSub = 131,
  kFMul = 133,
  kFDiv = 136,
  kVectorTimesScalar = 142,
  kMatrixTimesVector = 145,
  kDot = 148,
  kSelect = 169,
  kFOrdLessThan = 184,
};
constexpr uint32_t kNoContraction = 42, kFAbs = 4, kSqrt = 31, kInverseSqrt = 32, kFMax = 40, kFMix = 46;

/// A float, or a vector of them, with what is needed to compute with it.
struct Type {
  uint32_t size = 1;       // components
  uint32_t condition = 0;  // bool, or a vector of them
  uint32_t zero = 0, one = 0, splitter = 0, last_digit = 0, large = 0;
};

class Rewriter {
 public:
  explicit Rewriter(std::span<const uint32_t> words) : in_(words), bound_(words[3]) {}

  std::vector<uint32_t> run() {
    look();
    if (!glsl_) return {in_.begin(), in_.end()};
    out_.assign(in_.begin(), in_.begin() + 5);
    bool in_functions = false;
    for (size_t at = 5; at < in_.size(); at += in_[at] >> 16) {
      const std::span<const uint32_t> one = in_.subspan(at, in_[at] >> 16);
      if ((one[0] & 0xffff) == kFunction && !in_functions) {
        in_functions = true;
        declare();
      }
      if (!in_functions || !rewrite(one)) out_.insert(out_.end(), one.begin(), one.end());
    }
    out_[3] = bound_;
    return out_;
  }

 private:
  using Words = std::initializer_list<uint32_t>;
  void put(uint32_t op, Words operands) {
    out_.push_back(static_cast<uint32_t>(operands.size() + 1) << 16 | op);
    out_.insert(out_.end(), operands);
  }
  /// An operation of two operands; its result.
  uint32_t make(uint32_t op, uint32_t type, uint32_t a, uint32_t b) {
    const uint32_t id = bound_++;
    put(op, {type, id, a, b});
    return id;
  }

  void look() {
    for (size_t at = 5; at < in_.size(); at += in_[at] >> 16) {
      const uint32_t* w = &in_[at];
      switch (w[0] & 0xffff) {
        case kExtInstImport:
          if (std::string_view(reinterpret_cast<const char*>(w + 2)) == "GLSL.std.450") glsl_ = w[1];
          break;
        case kTypeBool: conditions_[1] = w[1]; break;
        case kTypeFloat:
          if (w[2] == 32) types_[float_ = w[1]].size = 1;
          break;
        case kTypeVector:
          if (w[2] == float_ && float_) types_[w[1]].size = w[3];
          if (w[2] == conditions_[1] && w[2]) conditions_[w[3]] = w[1];
          break;
        case kDecorate:
          if (w[2] == kNoContraction) precise_.insert(w[1]);
          break;
        default:
          if (w[0] >> 16 >= 3 && types_.count(w[1])) of_[w[2]] = w[1];
          break;
      }
    }
  }

  uint32_t constant(uint32_t type, uint32_t size, float value) {
    uint32_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    uint32_t id = bound_++;
    put(kConstant, {float_, id, bits});
    if (size == 1) return id;
    const uint32_t whole = bound_++;
    out_.push_back((3 + size) << 16 | kConstantComposite);
    out_.insert(out_.end(), {type, whole});
    out_.insert(out_.end(), size, id);
    return whole;
  }

  void declare() {
    if (!conditions_[1]) put(kTypeBool, {conditions_[1] = bound_++});
    for (auto& [id, type] : types_) {
      uint32_t& condition = conditions_[type.size];
      if (!condition) put(kTypeVector, {condition = bound_++, conditions_[1], type.size});
      type.condition = condition;
      type.zero = constant(id, type.size, 0);
      type.one = constant(id, type.size, 1);
      type.splitter = constant(id, type.size, 4097);
      type.last_digit = constant(id, type.size, 1 + 0x1p-23f);
      type.large = constant(id, type.size, 1e30f);
    }
  }

  /// The upper half of a float's digits, and the lower.
  std::pair<uint32_t, uint32_t> halves(uint32_t type, uint32_t a) {
    const uint32_t t = make(kFMul, type, types_[type].splitter, a);
    const uint32_t high = make(kFSub, type, t, make(kFSub, type, t, a));
    return {high, make(kFSub, type, a, high)};
  }

  uint32_t absolute(uint32_t type, uint32_t a) {
    const uint32_t id = bound_++;
    put(kExtInst, {type, id, glsl_, kFAbs, a});
    return id;
  }

  /// What the product a b lacks; nothing where one of them is so large that it cannot be halved. (e == e and e - e == 0 do not
  /// tell: Mesa takes them for true.)
  uint32_t lost(uint32_t type, uint32_t product, uint32_t a, uint32_t b) {
    const auto [ah, al] = halves(type, a);
    const auto [bh, bl] = halves(type, b);
    uint32_t e = make(kFSub, type, make(kFMul, type, ah, bh), product);
    e = make(kFAdd, type, e, make(kFMul, type, ah, bl));
    e = make(kFAdd, type, e, make(kFMul, type, al, bh));
    e = make(kFAdd, type, e, make(kFMul, type, al, bl));
    uint32_t largest = absolute(type, product);
    for (const uint32_t factor : {a, b}) {
      const uint32_t most = bound_++;
      put(kExtInst, {type, most, glsl_, kFMax, largest, absolute(type, factor)});
      largest = most;
    }
    const uint32_t small = make(kFOrdLessThan, types_[type].condition, largest, types_[type].large), id = bound_++;
    put(kSelect, {type, id, small, e, types_[type].zero});
    return id;
  }

  uint32_t part(uint32_t type, uint32_t whole, uint32_t i) {
    const uint32_t id = bound_++;
    put(kCompositeExtract, {type, id, whole, i});
    return id;
  }
  /// A vector of the same number, or the number.
  uint32_t splat(uint32_t type, uint32_t scalar) {
    if (types_[type].size == 1) return scalar;
    const uint32_t id = bound_++;
    out_.push_back((3 + types_[type].size) << 16 | kCompositeConstruct);
    out_.insert(out_.end(), {type, id});
    out_.insert(out_.end(), types_[type].size, scalar);
    return id;
  }

  /// dot(a, b), of numbers, or M v, of columns and numbers.
  void sum_of_products(uint32_t type, uint32_t result, uint32_t a, uint32_t b) {
    const uint32_t count = types_[of_[b]].size;
    uint32_t sum = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const uint32_t x = part(type, a, i), y = splat(type, part(float_, b, i)), product = make(kFMul, type, x, y);
      if (i == 0) {
        sum = product;
        continue;
      }
      const uint32_t rounded = make(kFAdd, type, sum, product), error = lost(type, product, x, y);
      if (i + 1 < count)
        sum = make(kFAdd, type, rounded, error);
      else
        put(kFAdd, {type, result, rounded, error});
    }
  }

  bool rewrite(std::span<const uint32_t> w) {
    const uint32_t op = w[0] & 0xffff;
    if (w.size() < 5 || !types_.count(w[1]) || precise_.count(w[2])) return false;
    const uint32_t type = w[1], result = w[2];
    const Type& known = types_[type];
    if (op == kFMul) {
      products_[result] = {w[3], w[4]};
      return false;
    }
    if (op == kVectorTimesScalar) {
      products_[result] = {w[3], splat(type, w[4])};
      return false;
    }
    if (op == kFAdd || op == kFSub) {
      const bool first = products_.count(w[3]) > 0;
      if (!first && !products_.count(w[4])) return false;
      const uint32_t product = first ? w[3] : w[4];
      const auto [a, b] = products_[product];
      const uint32_t error = lost(type, product, a, b), sum = make(op, type, w[3], w[4]);
      put(op == kFSub && !first ? kFSub : kFAdd, {type, result, sum, error});
      return true;
    }
    if (op == kDot || op == kMatrixTimesVector) {
      sum_of_products(type, result, w[3], w[4]);
      return true;
    }
    if (op == kFDiv) {
      const uint32_t reciprocal = make(kFMul, type, make(kFDiv, type, known.one, w[4]), known.last_digit);
      put(kFMul, {type, result, w[3], reciprocal});
      return true;
    }
    if (op != kExtInst || w[3] != glsl_) return false;
    if (w[4] == kSqrt || w[4] == kInverseSqrt) {
      const uint32_t exact = bound_++;
      put(kExtInst, {type, exact, w[3], w[4], w[5]});
      put(kFMul, {type, result, exact, known.last_digit});
      return true;
    }
    if (w[4] == kFMix) {
      put(kFAdd, {type, result, w[5], make(kFMul, type, make(kFSub, type, w[6], w[5]), w[7])});
      return true;
    }
    return false;
  }

  std::span<const uint32_t> in_;
  std::vector<uint32_t> out_;
  uint32_t bound_, glsl_ = 0, float_ = 0;
  std::map<uint32_t, Type> types_;
  uint32_t conditions_[5] = {};  // bool and its vectors, by size
  std::set<uint32_t> precise_;
  std::map<uint32_t, uint32_t> of_;  // type by id, of such a type
  std::map<uint32_t, std::pair<uint32_t, uint32_t>> products_;
};

}  // namespace

std::vector<uint32_t> as_gpus_round(std::span<const uint32_t> words) { return Rewriter(words).run(); }

}  // namespace iclk::test
