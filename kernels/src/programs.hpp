// Expressions of laws as Python hands them over, checked.
#pragma once
#include "arrays.hpp"
#include "problem.hpp"

namespace dashpot {

struct OwnPrograms {
    std::vector<int> start;
    std::vector<LawStep> steps;
    int names = 0, depth = 0;

    // starts (programs + 1,), where each begins; code, which, number (steps,).
    void take(const Integers &starts, const Integers &code, const Integers &which, const Reals &number) {
        require(starts.size() > 0 && code.size() == which.size() && code.size() == number.size() &&
                    starts.data()[starts.size() - 1] == static_cast<int64_t>(code.size()),
                "arrays of programs have different sizes");
        start.assign(starts.data(), starts.data() + starts.size());
        for (size_t k = 0; k + 1 < start.size(); ++k) require(start[k] >= 0 && start[k] <= start[k + 1], "programs overlap");
        for (size_t k = 0; k < code.size(); ++k) {
            require(code.data()[k] >= 0 && code.data()[k] < static_cast<int64_t>(LawCode::ALL), "there is no such step");
            steps.push_back({static_cast<LawCode>(code.data()[k]), static_cast<int>(which.data()[k]), number.data()[k]});
        }
    }
    // Names and depth of the stack of one program, whose steps must leave one value.
    void measure(int row, int count) {
        require(count >= 2 && count <= 32 && start[row] < start[row + 1], "a law has no steps or too many constants");
        names = std::max(names, count);
        int top = 0;
        for (int k = start[row]; k < start[row + 1]; ++k) {
            const LawCode code = steps[k].code;
            require(code != LawCode::NAME || (steps[k].which >= 0 && steps[k].which < count), "a law names no such constant");
            require(code != LawCode::WHOLE_POWER || steps[k].which > 0, "a whole power is positive");
            const bool leaf = code == LawCode::NUMBER || code == LawCode::NAME;
            const bool two = code == LawCode::MIN || code == LawCode::MAX || code >= LawCode::PLUS;
            const int taken = leaf ? 0 : code == LawCode::WHERE ? 3 : two ? 2 : 1;
            require(top >= taken, "a step of a law lacks an operand");
            top += 1 - taken;
            depth = std::max(depth, top);
        }
        require(top == 1, "a law leaves more than one value");
    }
    Programs view() const { return {names, depth, start.data(), steps.data()}; }
};

}  // namespace dashpot
