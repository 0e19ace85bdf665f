// What the loops work on: plain pointers, so that code of several instruction sets may share them.
#pragma once

namespace dashpot {

// A rig at its lines.  Arrays over lines have a stride of `stride`, a multiple of 8, and repeat the last line.
struct Rig {
    int n, r, s, elements, unknowns, lines, stride;
    const double *T, *p0;  // p = T theta + p0
    // Entries of the letter matrices: += value * p[element] at place = row (n + r) + column.
    int cells;
    const int *cell_element, *cell_letter, *cell_place;
    const double *cell_value;
    // Places of [D | -R] that can differ from 0, row by row.
    const int *row_start, *row_column;
    // phi of the letters M, C, K, H, real or imaginary; (4, stride)
    const double *factor;
    bool imaginary[4], used[4];
    const int *letter;  // of each element
    // Points (coordinates, then displacement inputs) that each element joins.
    const int *join_start, *join_point;
    const double *join_value;
    // Elements with an unknown part, and the elements of each unknown.
    int active;
    const int *active_element;
    const int *tie_start, *tie_active;
    const double *tie_value;
    // Entries of B^T diag(a) T: rows of each unknown's column, and the terms of each entry.
    const int *column_start, *entry_row, *term_start, *term_active;
    const double *term_value;
    // Elements with a known part.
    int known;
    const int *known_element;
    const double *S;                   // (n, s)
    const double *precision, *mean;    // priors, (unknowns,)
};

// Measured states of K repeats: z (K, lines, q) and its covariance (K or 1, lines, q, q), complex.
struct Equation {
    const Rig *rig;
    int repeats, q;
    const double *z, *covariance;
    bool shared;  // one covariance for all repeats
    // Places of the covariance that are not 0 throughout.
    int places;
    const int *place_row, *place_column;
    const unsigned char *row_noisy;  // (q,)
};

// Channels of K repeats: y (K, lines, channels), W (K or 1, lines, channels, channels), inputs (K, lines, r + s).
struct Output {
    const Rig *rig;
    int repeats, channels, gains, delays, all;  // all: unknowns with gains and delays
    const double *y, *W, *inputs;               // inputs may be null: estimated line by line
    bool shared, diagonal;
    const double *rate;             // (channels, stride), (j omega)^derivative
    const unsigned char *turned;    // (channels,), whether that is imaginary
    const double *omega;            // (stride,)
    const double *on_x, *on_q, *force;  // (channels, n), (channels, r + s), (channels, elements)
    const unsigned char *sees;      // (channels,), whether it shows more than inputs
    const unsigned char *has_force; // (channels,)
    const int *gain, *delay;        // (channels,)
    bool calibrated;                // some gain, delay or sign is to be found
    const double *precision, *mean; // (all,)
};

// Whole records among the lines of an Output that has no data of its own.  The lines of a record stand side by side,
// filled up to a multiple of 8 by lines that weigh nothing.
struct Records {
    const Output *output;
    int records, segments, columns, of_inputs, fitted, terms;
    const int *start, *owner;            // (segments + 1,) first lines; (segments,) records, -1 of settled lines
    const int *line;                     // (stride,) which line of the spectrum, -1 of those that fill up
    int lines;                           // of the spectrum
    const double *s;                     // (stride,) omega over the highest of its record
    const unsigned char *loads, *used;   // (records,), (records, columns)
    const double *by_input;              // (r + s, of_inputs, 2, stride)
    const int *fitted_channel, *fitted_power, *powers;  // (fitted,), (fitted,), (terms,)
    bool one, shared;                    // one repeat, and one set of weights, for all parameter sets
    // (K or 1, channels, 2, stride); (K or 1, channels, stride), or null where channels are correlated and
    // (K or 1, channels, channels, 2, stride) is their root; (K or 1, r + s, 2, stride), null where inputs are estimated
    const double *y, *sd, *root, *q;
};

// K parameter sets.  What sampling folds back per load (K, records, channels, 2 n, 8) and, under the loads, by the
// unknowns of the rig (K, records, channels, unknowns, 8), in powers of s, may be null.  Coefficients of the columns
// (K, records, columns) and of each channel's powers (K, records, channels, terms) are null in the first pass.
struct RecordsAt {
    const double *psi, *sign, *folded, *z, *t, *folded_slopes;
};

struct Limits {
    const double *lower, *upper, *longest;  // (unknowns,)
    int limit, patience;
    double tolerance;
    const unsigned char *logarithmic;  // (unknowns,), null: none
};

struct Ends {
    double *x, *cost;
    unsigned char *converged;
    long long *iterations;
    double *history;     // of the first row, (limit + 1, unknowns); may be null
    int *history_rows;
    double *sum = nullptr, *gradient = nullptr, *symmetric = nullptr, *free = nullptr;  // at the end; all or none
};

// What a law's program may do, in the order of dashpot.model.nonlinear.alternating.CODES: leaves, choices, functions of
// one operand and of two.
enum class LawCode : int {
    NUMBER, NAME, WHERE, MIN, MAX, NEGATIVE, WHOLE_POWER, ABS, SIGN, TANH, EXP, LOG, SQRT, SIN, COS,
    PLUS, MINUS, TIMES, OVER, POWER, ALL
};

// `which`: the name (0 d, 1 v, 2 … the law's constants, behind them its state z) or the exponent.
struct LawStep {
    LawCode code;
    int which;
    double number;
};

// Expressions of laws; names: of the one that has most, depth: of the stack that the deepest needs.
struct Programs {
    int names, depth;
    const int *step_start;  // (programs + 1,)
    const LawStep *steps;
};

// A rig with nonlinear elements, whose laws are programs of steps; `bent` counts these elements.
struct NonlinearRig {
    int n, r, s, elements, bent, constants;
    Programs laws;
    const double *B, *D, *S;            // (elements, n), (elements, r), (n, s)
    const int *chosen, *constant_start;  // (bent,), (bent + 1,)
    // Entries of the linear elements: += value * p[element] * factor[element] at place = row (n + r) + column.
    int cells;
    const int *cell_element, *cell_place;
    const double *cell_value;
};

// N dwells with the harmonics 0 … orders and what drives them; complex numbers as pairs.
struct Dwells {
    int count, orders, times;
    const double *p, *constants, *omega;  // (N, elements), (N, constants), (N,)
    const double *factors;                // (N, orders + 1, elements), complex
    const double *U, *f;                  // (N, orders + 1, r) and (N, orders + 1, s), complex
    bool feeds_back;                      // whether any nonlinear element has a strength
};

// The equations of harmonic balance and where Newton's method left them, W = 2 orders + 1 real numbers an element.
struct BalanceAt {
    double *inverse, *receptance, *share, *driven, *free;  // (N, orders + 1, …), complex
    double *free_real, *q, *a, *slope, *by_constant, *error;
};

// Directions: along_p (elements, Q), along_constants (constants, Q), along_U and along_f (N or 1, orders + 1, …, Q),
// complex, or null; a (N, orders + 1, elements), complex.
struct Directions {
    int count;
    const double *along_p, *along_constants, *along_U, *along_f;
    bool same;  // along_U and along_f of all dwells
    const double *a;
    double *dX, *d_forces, *d_delta;
};

// Lines of `dwells` dwells, the same in all repeats, and what channels show at them.  The lines of a dwell stand side by
// side: `line` says which line of the spectrum, `order` which harmonic; first (dwells + 1,).  Dwells holds p and
// constants by repeat, omega and factors by dwell.
struct NonlinearLines {
    int count, dwells, channels, directions;
    const int *first, *line, *order;
    const double *rates, *on_x, *on_q, *force;  // (lines, channels) complex, (channels, …)
    const double *q;                            // (K, lines, r + s), complex
    const double *start;                        // (K, dwells, e, W), or null
    const double *along_p, *along_constants;    // (elements, Q), (constants, Q)
    const double *along_U, *along_f;            // (dwells, orders + 1, …, Q), complex, or null
    double *shown, *slopes;                     // (K, lines, channels) and (K, lines, channels, Q), complex
    double *delta, *d_delta, *error;            // (K, dwells, e, W), (K, dwells, e, W, Q), (K, dwells)
};

// Laws of which some have a state: program i is the unit force of law i, program laws + i the rate of its state, which
// is empty where there is none or `operated` says how it follows the elongation.
enum class Operator : int { NONE, STOP, PLAY };
struct StateLaws {
    int count;
    Programs programs;
    const int *constant_start;   // (laws + 1,)
    const Operator *operated;    // (laws,)
    int constants(int law) const { return constant_start[law + 1] - constant_start[law]; }
    bool rated(int law) const { return programs.step_start[count + law] < programs.step_start[count + law + 1]; }
    bool stateful(int law) const { return rated(law) || operated[law] != Operator::NONE; }
};

// One law with a rate in N settled dwells: d, v (N, times), constants (N, …), there and rate (times, W) from harmonics
// to a period and its rate at ω = 1.  State and force (N, times), and their slopes along harmonics and constants
// (N, times, W + constants) or null; z holds where Newton's method begins.
struct SettledStates {
    int law, times, width;
    const double *d, *v, *constants, *omega, *there, *rate;
    double *z, *force, *slopes;
};

// Segments of a record that are followed from states of their own over `steps` steps of h, `substeps` to a sample, by
// exponential collocation.  Elements in the order of the rig: power of s of the linear ones, -1 of others; unit forces
// (…, 4, e) and states (…, 4, z) at the points of steps.  columns: of slopes, 0, those of the states, or with the
// unknowns and offsets.
struct SegmentedMotion {
    int n, r, elements, unknowns, offsets, states, segments, steps, substeps, columns;
    double h;
    const double *within;                              // (4, 4), of the collocation
    const double *grown, *driven, *pulled;             // (2 n, 8 n), (8 n, 4 n), (4, 2 n, 4 e)
    const double *reach_d, *reach_v, *offset_moved;    // (4 e, 4 e), (4, 2 n, offsets)
    const double *forced, *moved_d, *moved_v, *force, *inputs;  // (all, 4, …): 2 n, e, e, n, (2, r)
    const double *B, *D, *T, *p, *constants, *by_unknowns;  // (elements, …); (constants, unknowns)
    const double *K, *C, *inertia;
    const int *power, *chosen;                         // (elements,), (e,)
    const long long *first;                            // (segments,), steps
    long long last;
    const double *begun, *guess_a, *guess_z;           // (segments, states); (steps, segments, …) or null
    double *state, *slopes, *a, *z;                    // of samples (steps / substeps + 1, segments, …); of steps
    bool whole;                                        // slopes of all samples, else those of the ends alone
};

enum Kind { SQUARES = 0, LOGARITHMS = 1 };

// One set of loops; each works on rows `from` to `to` with a workspace of the size it names.
struct Loops {
    const char *name;
    unsigned long (*equation_workspace)(const Equation &);
    void (*equation_evaluate)(const Equation &, const double *theta, const long long *rows, long from, long to,
                              double *cost, double *gradient, double *symmetric, double *mixed, char *work);
    void (*equation_lines)(const Equation &, const double *theta, long from, long to, double *information,
                           double *scores, double *cost, char *work);
    void (*equation_starts)(const Equation &, long from, long to, double *clean, double *weighted, double *plain,
                            char *work);
    void (*equation_descend)(const Equation &, const double *start, const long long *rows, long from, long to,
                             const Limits &, const Ends &, char *work);
    unsigned long (*output_workspace)(const Output &);
    void (*output_evaluate)(const Output &, const double *psi, const double *sign, const long long *rows, long from,
                            long to, int kind, const double *weight, bool slopes, double *cost, double *gradient,
                            double *information, char *work);
    void (*output_lines)(const Output &, const double *psi, const double *sign, long from, long to,
                         double *information, double *scores, double *cost, char *work);
    void (*output_descend)(const Output &, const double *start, const double *sign, const long long *rows, long from,
                           long to, int kind, const double *weight, const Limits &, const Ends &, char *work);
    unsigned long (*records_workspace)(const Records &);
    void (*records_columns)(const Records &, const RecordsAt &, long from, long to, double *columns, double *basis,
                            char *work);
    void (*records_slopes)(const Records &, const RecordsAt &, long from, long to, double *products, double *columns,
                           double *basis, char *work);
    void (*records_lines)(const Records &, const RecordsAt &, const double *z, const double *t, long from, long to,
                          double *information, double *scores, double *cost, char *work);
    void (*records_residuals)(const Records &, const RecordsAt &, long from, long to, double *residuals, char *work);
    void (*line_shares)(const double *information, const double *inflation, const double *bread, long lines, int m,
                        double *shares, double *diagonals);
    unsigned long (*balance_workspace)(const NonlinearRig &, const Dwells &, int directions);
    void (*balance_forces)(const NonlinearRig &, const Dwells &, const double *q, long from, long to, double *a,
                           char *work);
    void (*balance_linear_start)(const NonlinearRig &, const Dwells &, long from, long to, double *q, char *work);
    void (*balance_solve)(const NonlinearRig &, const Dwells &, const unsigned char *hopeless, long from, long to,
                          const BalanceAt &, char *work);
    void (*balance_slopes)(const NonlinearRig &, const Dwells &, const BalanceAt &, const Directions &, long from,
                           long to, char *work);
    void (*balance_lines)(const NonlinearRig &, const Dwells &, const NonlinearLines &, long from, long to, char *work);
    unsigned long (*settled_workspace)(const StateLaws &, const SettledStates &);
    void (*settled_states)(const StateLaws &, const SettledStates &, long from, long to, char *work);
    unsigned long (*history_workspace)(const StateLaws &, int samples);
    void (*state_history)(const StateLaws &, int law, const double *d, const double *v, const double *constants, double h,
                          int samples, double *z, char *work);
    unsigned long (*motion_workspace)(const StateLaws &, const SegmentedMotion &);
    void (*follow_motion)(const StateLaws &, const SegmentedMotion &, char *work);
};

}  // namespace dashpot
