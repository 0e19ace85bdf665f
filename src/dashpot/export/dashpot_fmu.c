/* A linear rig as an FMI 3.0 co-simulation unit.  The tables of rig.h say which rig it is.

   M x'' + C x' + K x = F u' + G u + J u'' + S f

   The inputs w are u, u' or u'' of every moved point, and f.  During a step they go on with the slope that the
   importer sets (0: they are held); state and inputs together then obey one linear equation with constant
   coefficients, whose matrix exponential carries them over a step of any length without error. */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define SOME(k) ((k) > 0 ? (k) : 1) /* C has no arrays of length 0 */

#include "rig.h"

#if defined _WIN32 || defined __CYGWIN__
#define EXPORT __declspec(dllexport)
#elif __GNUC__ >= 4
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#define Q (R + S)            /* inputs */
#define Z (2 * N + LOWER)    /* states: displacements, velocities, lower derivatives of moved points */
#define T (Z + 2 * Q)        /* with the inputs and their slopes */

enum status { OK, WARNING, DISCARD, ERROR, FATAL };

typedef uint32_t reference;
typedef void (*log_message)(void *environment, int status, const char *category, const char *message);

struct rig {
    void *environment;
    log_message log;
    bool running;
    double time;
    double p[SOME(ROOTS)];       /* parameters that stand for themselves; others are multiples of them */
    double start[SOME(Z)];       /* x, x', and u or u and u' where these are states */
    double w[SOME(Q)], slope[SOME(Q)];
    double z[SOME(Z)];
    double A[SOME(Z)][SOME(Z)], B[SOME(Z)][SOME(Q)];
    double beta0[SOME(N)][SOME(R)], beta1[SOME(N)][SOME(R)];
    double values[SOME(E)];      /* parameters of all elements */
    double phi[SOME(Z)][SOME(T)]; /* carries (z, w, slope) over `step_of_phi` */
    double step_of_phi;
};

/* Value references, as modelDescription.xml has them */
enum {
    TIME, INPUT = 1, SLOPE = INPUT + Q, OUTPUT = SLOPE + Q, PARAMETER = OUTPUT + O, START = PARAMETER + ROOTS,
    END = START + Z
};

static int said(const struct rig *rig, int status, const char *message) {
    if (rig->log != NULL) rig->log(rig->environment, status, "logStatusError", message);
    return status;
}

/* Solve M X = right in place by elimination with pivots; false where M is singular. */
static bool solved(double M[][SOME(N)], double right[][SOME(2 * N + 3 * R + S)], int columns) {
    for (int k = 0; k < N; k++) {
        int pivot = k;
        for (int i = k + 1; i < N; i++)
            if (fabs(M[i][k]) > fabs(M[pivot][k])) pivot = i;
        if (!(fabs(M[pivot][k]) > 0)) return false;
        if (pivot != k) {
            for (int j = 0; j < N; j++) { double t = M[k][j]; M[k][j] = M[pivot][j]; M[pivot][j] = t; }
            for (int j = 0; j < columns; j++) {
                double t = right[k][j]; right[k][j] = right[pivot][j]; right[pivot][j] = t;
            }
        }
        for (int i = 0; i < N; i++) {
            if (i == k) continue;
            double factor = M[i][k] / M[k][k];
            if (factor == 0) continue;
            for (int j = k; j < N; j++) M[i][j] -= factor * M[k][j];
            for (int j = 0; j < columns; j++) right[i][j] -= factor * right[k][j];
        }
    }
    for (int k = 0; k < N; k++)
        for (int j = 0; j < columns; j++) right[k][j] /= M[k][k];
    return true;
}

/* Where u^(d) of moved point j stands among the states, d below its order. */
static int lower(int j, int d) {
    int at = 2 * N + d;
    for (int i = 0; i < j; i++) at += order_of[i];
    return at;
}

/* A, B and the shifts from the parameters. */
static bool assembled(struct rig *rig) {
    enum { KX = 0, CX = N, GU = 2 * N, FU = GU + R, JU = FU + R, SF = JU + R, ALL = SF + S };
    double (*M)[SOME(N)] = calloc(SOME(N), sizeof *M);
    double (*X)[SOME(2 * N + 3 * R + S)] = calloc(SOME(N), sizeof *X);
    bool fine = M != NULL && X != NULL;
    if (fine) {
        for (int e = 0; e < E; e++) {
            double p = rig->values[e] = times_of[e] * rig->p[root_of[e]];
            int inner = power_of[e] == 0 ? KX : CX, driven = power_of[e] == 0 ? GU : power_of[e] == 1 ? FU : JU;
            for (int i = 0; i < N; i++) {
                double b = p * along_x[e][i];
                if (b == 0) continue;
                for (int j = 0; j < N; j++)
                    if (power_of[e] == 2) M[i][j] += b * along_x[e][j];
                    else X[i][inner + j] += b * along_x[e][j];
                for (int j = 0; j < R; j++) X[i][driven + j] -= b * along_u[e][j];
            }
        }
        for (int i = 0; i < N; i++)
            for (int j = 0; j < S; j++) X[i][SF + j] = force_at[i][j];
        fine = solved(M, X, ALL);
    }
    if (fine) {
        memset(rig->A, 0, sizeof rig->A);
        memset(rig->B, 0, sizeof rig->B);
        for (int i = 0; i < N; i++) {
            rig->A[i][N + i] = 1;
            for (int j = 0; j < N; j++) {
                rig->A[N + i][j] = -X[i][KX + j];
                rig->A[N + i][N + j] = -X[i][CX + j];
            }
            for (int j = 0; j < S; j++) rig->B[N + i][R + j] = X[i][SF + j];
        }
        for (int j = 0; j < R; j++) {
            for (int i = 0; i < N; i++) {
                rig->beta0[i][j] = order_of[j] == 0 ? X[i][JU + j] : 0;
                rig->beta1[i][j] = order_of[j] == 1 ? X[i][JU + j] : 0;
                if (order_of[j] == 0) {
                    rig->beta1[i][j] = X[i][FU + j];
                    for (int k = 0; k < N; k++) rig->beta1[i][j] -= X[i][CX + k] * X[k][JU + j];
                }
            }
            for (int i = 0; i < N; i++) {
                double force = X[i][(order_of[j] == 0 ? GU : order_of[j] == 1 ? FU : JU) + j];
                for (int k = 0; k < N; k++)
                    force -= X[i][KX + k] * rig->beta0[k][j] + X[i][CX + k] * rig->beta1[k][j];
                rig->B[i][j] = rig->beta1[i][j];
                rig->B[N + i][j] = force;
                for (int d = 0; d < order_of[j]; d++) rig->A[N + i][lower(j, d)] = X[i][(d == 0 ? GU : FU) + j];
            }
            for (int d = 0; d < order_of[j]; d++) {
                if (d + 1 < order_of[j]) rig->A[lower(j, d)][lower(j, d + 1)] = 1;
                else rig->B[lower(j, d)][j] = 1;
            }
        }
    }
    free(M);
    free(X);
    rig->step_of_phi = 0;
    return fine;
}

/* Diagonal scaling by powers of two that makes rows and columns alike in size (Parlett and Reinsch 1969). */
static void balance(double *H, double *scale) {
    bool moved = true;
    for (int i = 0; i < T; i++) scale[i] = 1;
    for (int sweep = 0; moved && sweep < 50; sweep++) {
        moved = false;
        for (int i = 0; i < T; i++) {
            double row = 0, column = 0, factor = 1;
            for (int j = 0; j < T; j++) {
                if (j == i) continue;
                row += fabs(H[i * T + j]);
                column += fabs(H[j * T + i]);
            }
            if (row == 0 || column == 0) continue;
            double sum = row + column;
            while (column < row / 2) { factor *= 2; column *= 2; row /= 2; }
            while (column >= row * 2) { factor /= 2; column /= 2; row *= 2; }
            if (row + column >= 0.95 * sum) continue;
            moved = true;
            scale[i] *= factor;
            for (int j = 0; j < T; j++) { H[i * T + j] /= factor; }
            for (int j = 0; j < T; j++) { H[j * T + i] *= factor; }
        }
    }
}

static void product(const double *left, const double *right, double *out) {
    memset(out, 0, sizeof(double) * T * T);
    for (int i = 0; i < T; i++)
        for (int k = 0; k < T; k++) {
            double factor = left[i * T + k];
            if (factor == 0) continue;
            for (int j = 0; j < T; j++) out[i * T + j] += factor * right[k * T + j];
        }
}

/* exp of the whole system over a step, by Taylor's series of a fraction of it that is then squared. */
static bool carried_over(struct rig *rig, double step) {
    double *H = calloc((size_t)4 * T * T + T, sizeof *H);
    if (H == NULL) return false;
    double *sum = H + T * T, *term = sum + T * T, *next = term + T * T, *scale = next + T * T;
    for (int i = 0; i < Z; i++) {
        for (int j = 0; j < Z; j++) H[i * T + j] = rig->A[i][j] * step;
        for (int j = 0; j < Q; j++) H[i * T + Z + j] = rig->B[i][j] * step;
    }
    for (int j = 0; j < Q; j++) H[(Z + j) * T + Z + Q + j] = step;
    balance(H, scale);
    double norm = 0;
    for (int j = 0; j < T; j++) {
        double column = 0;
        for (int i = 0; i < T; i++) column += fabs(H[i * T + j]);
        if (column > norm) norm = column;
    }
    int halvings = 0;
    for (; norm > 0.25 && halvings < 1000; halvings++) norm /= 2;
    for (int i = 0; i < T * T; i++) H[i] = ldexp(H[i], -halvings);
    for (int i = 0; i < T; i++) sum[i * T + i] = term[i * T + i] = 1;
    for (int k = 1; k <= 14; k++) {
        product(H, term, next);
        for (int i = 0; i < T * T; i++) { term[i] = next[i] / k; sum[i] += term[i]; }
    }
    for (int k = 0; k < halvings; k++) {
        product(sum, sum, next);
        memcpy(sum, next, sizeof(double) * T * T);
    }
    bool finite = true;
    for (int i = 0; i < Z; i++)
        for (int j = 0; j < T; j++) {
            rig->phi[i][j] = sum[i * T + j] * scale[i] / scale[j];
            finite = finite && isfinite(rig->phi[i][j]);
        }
    free(H);
    rig->step_of_phi = step;
    return finite;
}

static double moved(const struct rig *rig, int j, int d) {
    return d < order_of[j] ? rig->z[lower(j, d)] : d == order_of[j] ? rig->w[j] : 0;
}

/* Displacement, velocity or acceleration of a coordinate; what depends on derivatives of w no output contains. */
static double motion(const struct rig *rig, int i, int d) {
    double value = 0;
    if (d < 2) {
        value = rig->z[d * N + i];
        for (int j = 0; j < R; j++) value += (d == 0 ? rig->beta0 : rig->beta1)[i][j] * rig->w[j];
        return value;
    }
    for (int k = 0; k < Z; k++) value += rig->A[N + i][k] * rig->z[k];
    for (int k = 0; k < Q; k++) value += rig->B[N + i][k] * rig->w[k];
    return value;
}

static double output(const struct rig *rig, int o) {
    double value = 0;
    for (int i = 0; i < N; i++)
        if (on_x[o][i] != 0) value += on_x[o][i] * motion(rig, i, derivative_of[o]);
    for (int j = 0; j < R; j++)
        if (on_q[o][j] != 0) value += on_q[o][j] * moved(rig, j, derivative_of[o]);
    for (int j = 0; j < S; j++) value += on_q[o][R + j] * rig->w[R + j];
    for (int e = 0; e < E; e++) {
        if (on_force[o][e] == 0) continue;
        double elongation = 0;
        for (int i = 0; i < N; i++)
            if (along_x[e][i] != 0) elongation += along_x[e][i] * motion(rig, i, power_of[e]);
        for (int j = 0; j < R; j++)
            if (along_u[e][j] != 0) elongation += along_u[e][j] * moved(rig, j, power_of[e]);
        value += on_force[o][e] * rig->values[e] * elongation;
    }
    return value;
}

/* The state from x, x' and u at the start. */
static void begin(struct rig *rig) {
    memcpy(rig->z, rig->start, sizeof rig->z);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < R; j++) {
            rig->z[i] -= rig->beta0[i][j] * rig->w[j];
            rig->z[N + i] -= rig->beta1[i][j] * rig->w[j] + rig->beta0[i][j] * rig->slope[j];
        }
}

static void defaults(struct rig *rig) {
    rig->time = 0;
    rig->running = false;
    memset(rig->w, 0, sizeof rig->w);
    memset(rig->slope, 0, sizeof rig->slope);
    memset(rig->start, 0, sizeof rig->start);
    for (int k = 0; k < ROOTS; k++) rig->p[k] = default_of[k];
    if (assembled(rig)) begin(rig);
}

/* Where a variable that may be set is kept; NULL for any other. */
static double *place(struct rig *rig, reference at) {
    if (at >= INPUT && at < SLOPE) return &rig->w[at - INPUT];
    if (at >= SLOPE && at < OUTPUT) return &rig->slope[at - SLOPE];
    if (at >= PARAMETER && at < START) return &rig->p[at - PARAMETER];
    if (at >= START && at < END) return &rig->start[at - START];
    return NULL;
}

/* The functions of FMI 3.0 */

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging, bool events, bool early,
    const reference required[], size_t count, void *environment, log_message log, void (*update)(void)) {
    (void)name; (void)resources; (void)visible; (void)logging; (void)early; (void)required; (void)count; (void)update;
    if (events || token == NULL || strcmp(token, TOKEN) != 0) {
        if (log != NULL) log(environment, ERROR, "logStatusError", events ? "no event mode" : "wrong token");
        return NULL;
    }
    struct rig *rig = calloc(1, sizeof *rig);
    if (rig == NULL) return NULL;
    rig->environment = environment;
    rig->log = log;
    defaults(rig);
    return rig;
}

EXPORT void fmi3FreeInstance(void *instance) { free(instance); }

EXPORT int fmi3SetDebugLogging(void *instance, bool on, size_t count, const char *const categories[]) {
    (void)instance; (void)on; (void)count; (void)categories;
    return OK;
}

EXPORT int fmi3EnterInitializationMode(
    void *instance, bool tolerance_defined, double tolerance, double start, bool stop_defined, double stop) {
    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    ((struct rig *)instance)->time = start;
    return OK;
}

EXPORT int fmi3ExitInitializationMode(void *instance) {
    struct rig *rig = instance;
    if (!assembled(rig)) return said(rig, ERROR, "the mass matrix is singular");
    begin(rig);
    rig->running = true;
    return OK;
}

EXPORT int fmi3Terminate(void *instance) { (void)instance; return OK; }

EXPORT int fmi3Reset(void *instance) { defaults(instance); return OK; }

EXPORT int fmi3DoStep(
    void *instance, double now, double step, bool no_set_state, bool *event, bool *terminate, bool *early,
    double *last) {
    struct rig *rig = instance;
    double before[SOME(T)], after[SOME(Z)];
    (void)no_set_state;
    *event = *terminate = *early = false;
    *last = now;
    if (!(step >= 0) || !isfinite(step)) return said(rig, ERROR, "a step must be positive and finite");
    /* Steps that differ by rounding alone share their matrix. */
    if (fabs(step - rig->step_of_phi) > 1e-13 * step && !carried_over(rig, step))
        return said(rig, ERROR, "the motion grows without bounds over this step");
    memcpy(before, rig->z, sizeof(double) * Z);
    memcpy(before + Z, rig->w, sizeof(double) * Q);
    memcpy(before + Z + Q, rig->slope, sizeof(double) * Q);
    for (int i = 0; i < Z; i++) {
        after[i] = 0;
        for (int j = 0; j < T; j++) after[i] += rig->phi[i][j] * before[j];
    }
    memcpy(rig->z, after, sizeof(double) * Z);
    for (int j = 0; j < Q; j++) rig->w[j] += rig->slope[j] * step;
    rig->time = *last = now + step;
    return OK;
}

EXPORT int fmi3GetFloat64(void *instance, const reference at[], size_t count, double values[], size_t size) {
    struct rig *rig = instance;
    if (count != size) return said(rig, ERROR, "all variables are scalars");
    for (size_t k = 0; k < count; k++) {
        const double *kept = place(rig, at[k]);
        if (at[k] == TIME) values[k] = rig->time;
        else if (kept != NULL) values[k] = *kept;
        else if (at[k] >= OUTPUT && at[k] < PARAMETER) values[k] = output(rig, (int)(at[k] - OUTPUT));
        else return said(rig, ERROR, "there is no such variable");
    }
    return OK;
}

EXPORT int fmi3SetFloat64(void *instance, const reference at[], size_t count, const double values[], size_t size) {
    struct rig *rig = instance;
    if (count != size) return said(rig, ERROR, "all variables are scalars");
    for (size_t k = 0; k < count; k++) {
        double *kept = place(rig, at[k]);
        if (kept == NULL || (rig->running && at[k] >= PARAMETER))
            return said(rig, ERROR, "this variable cannot be set (now)");
        *kept = values[k];
    }
    if (!rig->running && assembled(rig)) begin(rig);
    return OK;
}

EXPORT int fmi3GetFMUState(void *instance, void **state) {
    if (*state == NULL) *state = malloc(sizeof(struct rig));
    if (*state == NULL) return said(instance, ERROR, "out of memory");
    memcpy(*state, instance, sizeof(struct rig));
    return OK;
}

EXPORT int fmi3SetFMUState(void *instance, void *state) { memcpy(instance, state, sizeof(struct rig)); return OK; }

EXPORT int fmi3FreeFMUState(void *instance, void **state) {
    (void)instance;
    free(*state);
    *state = NULL;
    return OK;
}

/* What this unit has not: other kinds of variables, other kinds of simulation, clocks, derivatives. */

#define HAS_NOT(name, arguments) EXPORT int name arguments { return said(instance, ERROR, #name " is not for this unit"); }
#define OTHER(kind, type) \
    HAS_NOT(fmi3Get##kind, (void *instance, const reference at[], size_t count, type values[], size_t size)) \
    HAS_NOT(fmi3Set##kind, (void *instance, const reference at[], size_t count, const type values[], size_t size))

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

OTHER(Float32, float)
OTHER(Int8, int8_t)
OTHER(UInt8, uint8_t)
OTHER(Int16, int16_t)
OTHER(UInt16, uint16_t)
OTHER(Int32, int32_t)
OTHER(UInt32, uint32_t)
OTHER(Int64, int64_t)
OTHER(UInt64, uint64_t)
OTHER(Boolean, bool)
typedef const char *text;
OTHER(String, text)
typedef const uint8_t *bytes;
HAS_NOT(fmi3GetBinary, (void *instance, const reference at[], size_t n, size_t sizes[], bytes values[], size_t size))
HAS_NOT(fmi3SetBinary,
        (void *instance, const reference at[], size_t n, const size_t sizes[], const bytes values[], size_t size))
HAS_NOT(fmi3GetClock, (void *instance, const reference at[], size_t n, bool values[]))
HAS_NOT(fmi3SetClock, (void *instance, const reference at[], size_t n, const bool values[]))
HAS_NOT(fmi3GetNumberOfVariableDependencies, (void *instance, reference at, size_t *count))
HAS_NOT(fmi3GetVariableDependencies,
        (void *instance, reference at, size_t elements[], reference on[], size_t of[], int kinds[], size_t n))
HAS_NOT(fmi3SerializedFMUStateSize, (void *instance, void *state, size_t *size))
HAS_NOT(fmi3SerializeFMUState, (void *instance, void *state, uint8_t bytes[], size_t size))
HAS_NOT(fmi3DeserializeFMUState, (void *instance, const uint8_t bytes[], size_t size, void **state))
HAS_NOT(fmi3GetDirectionalDerivative,
        (void *instance, const reference unknowns[], size_t n, const reference knowns[], size_t m, const double seed[],
         size_t seeds, double sensitivity[], size_t sensitivities))
HAS_NOT(fmi3GetAdjointDerivative,
        (void *instance, const reference unknowns[], size_t n, const reference knowns[], size_t m, const double seed[],
         size_t seeds, double sensitivity[], size_t sensitivities))
HAS_NOT(fmi3EnterConfigurationMode, (void *instance))
HAS_NOT(fmi3ExitConfigurationMode, (void *instance))
HAS_NOT(fmi3EnterEventMode, (void *instance))
HAS_NOT(fmi3EnterStepMode, (void *instance))
HAS_NOT(fmi3GetIntervalDecimal, (void *instance, const reference at[], size_t n, double intervals[], int kinds[]))
HAS_NOT(fmi3GetIntervalFraction,
        (void *instance, const reference at[], size_t n, uint64_t counters[], uint64_t resolutions[], int kinds[]))
HAS_NOT(fmi3GetShiftDecimal, (void *instance, const reference at[], size_t n, double shifts[]))
HAS_NOT(fmi3GetShiftFraction, (void *instance, const reference at[], size_t n, uint64_t counters[], uint64_t of[]))
HAS_NOT(fmi3SetIntervalDecimal, (void *instance, const reference at[], size_t n, const double intervals[]))
HAS_NOT(fmi3SetIntervalFraction,
        (void *instance, const reference at[], size_t n, const uint64_t counters[], const uint64_t resolutions[]))
HAS_NOT(fmi3SetShiftDecimal, (void *instance, const reference at[], size_t n, const double shifts[]))
HAS_NOT(fmi3SetShiftFraction,
        (void *instance, const reference at[], size_t n, const uint64_t counters[], const uint64_t of[]))
HAS_NOT(fmi3EvaluateDiscreteStates, (void *instance))
HAS_NOT(fmi3UpdateDiscreteStates,
        (void *instance, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next))
HAS_NOT(fmi3EnterContinuousTimeMode, (void *instance))
HAS_NOT(fmi3CompletedIntegratorStep, (void *instance, bool no_set_state, bool *event, bool *terminate))
HAS_NOT(fmi3SetTime, (void *instance, double time))
HAS_NOT(fmi3SetContinuousStates, (void *instance, const double states[], size_t count))
HAS_NOT(fmi3GetContinuousStateDerivatives, (void *instance, double derivatives[], size_t count))
HAS_NOT(fmi3GetEventIndicators, (void *instance, double indicators[], size_t count))
HAS_NOT(fmi3GetContinuousStates, (void *instance, double states[], size_t count))
HAS_NOT(fmi3GetNominalsOfContinuousStates, (void *instance, double nominals[], size_t count))
HAS_NOT(fmi3GetNumberOfEventIndicators, (void *instance, size_t *count))
HAS_NOT(fmi3GetNumberOfContinuousStates, (void *instance, size_t *count))
HAS_NOT(fmi3GetOutputDerivatives,
        (void *instance, const reference at[], size_t n, const int32_t orders[], double values[], size_t size))
HAS_NOT(fmi3ActivateModelPartition, (void *instance, reference clock, double time))

EXPORT void *fmi3InstantiateModelExchange(
    const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment,
    log_message log) {
    return NULL;
}

EXPORT void *fmi3InstantiateScheduledExecution(
    const char *name, const char *token, const char *resources, bool visible, bool logging, void *environment,
    log_message log, void (*clock)(void *), void (*lock)(void), void (*unlock)(void)) {
    return NULL;
}
