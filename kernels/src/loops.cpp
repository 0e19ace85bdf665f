// All loops of one instruction set, named by DASHPOT_SET.
#include "balance.hpp"
#include "equation.hpp"
#include "motion.hpp"
#include "output.hpp"
#include "records.hpp"

#define TEXT_OF(x) #x
#define TEXT(x) TEXT_OF(x)

namespace DASHPOT_SET {

extern const dashpot::Loops LOOPS;
const dashpot::Loops LOOPS = {
    TEXT(DASHPOT_SET), equation_workspace, equation_evaluate, equation_lines, equation_starts, equation_descend,
    output_workspace,  output_evaluate,    output_lines,      output_descend, records_workspace,
    records_columns,   records_slopes,     records_lines,     records_residuals,
    line_shares,       balance_workspace, balance_forces,
    balance_linear_start, balance_solve, balance_slopes, balance_lines,
    settled_workspace, settled_states, history_workspace, state_history, motion_workspace, follow_motion,
};

}  // namespace DASHPOT_SET
