/* Holdfast model @MODEL_ID@ in C99: is a grip about to fail?

   SHA-256 of the ONNX file: @DIGEST@
   Made for @SENSORS@ sensors of 3 axes in @UNIT@, @RATE@ samples a second, within 10 %.

   Use
       holdfast_state state;              one for each hand; the library keeps nothing of its own
       holdfast_out out;
       holdfast_init(&state);             returns 0, or a code below
       for every sample:
           holdfast_step(&state, sample, &out);

   Compile with cc -std=c99 -O2 -ffp-contract=off, link with -lm. Results then have the same bits on
   every processor that follows IEEE 754. Without -ffp-contract=off their last bits may differ.

   Sample: @CHANNELS@ numbers, x y z of sensor 1, then of sensor 2, and so on; z presses on the
   fingertip. In @UNIT@, without bias: subtract what the unloaded hand reads, as HOLDFAST_BIAS_ROWS
   and the numbers behind it say; 0 rows: its samples have no bias.
@UNMEASURED@   A sensor with a number that is not finite, or of magnitude @LIMIT@ or more, counts as lost at
   this sample: write NaN for a finger that did not answer. A sample that never came is a step with
   NaN in every number. Call holdfast_init again after a gap of more than @GAP_MS@ ms without steps.

   Unknown: out.unknown is 1 until every sensor needed (@LEAST@ of @SENSORS@) has delivered
   @SETTLE@ samples without a gap of more than @GAP_MS@ ms, and whenever fewer sensors are good now.
   Then the other answers must not be used: a hand holds its grip on unknown, it never releases.
   The caller sees what this code cannot: set out.unknown = 1 where samples come at a wrong rate,
   repeat themselves or come late, before it calls holdfast_decide and holdfast_sense_of.

   Memory: state @STATE_BYTES@ bytes, tables @TABLE_BYTES@ bytes (constant), stack of a step about
   @STACK_BYTES@ bytes. No malloc, no globals that change: every function is reentrant.
   Faults: a state from another model or version gives a code and unknown = 1, never an answer. */
#ifndef HOLDFAST_H
#define HOLDFAST_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HOLDFAST_MODEL @TAG@
#define HOLDFAST_DIGEST "@DIGEST@"
#define HOLDFAST_SENSORS @SENSORS@
#define HOLDFAST_CHANNELS @CHANNELS@
#define HOLDFAST_FEATURES @FEATURES@
#define HOLDFAST_CLASSES @CLASSES@
#define HOLDFAST_RATE_HZ @RATE_HZ@
#define HOLDFAST_PERIOD_US @PERIOD_US@
#define HOLDFAST_UNIT "@UNIT@"
#define HOLDFAST_UNIT_IS_N @UNIT_IS_N@
#define HOLDFAST_SETTLE_SAMPLES @SETTLE@
#define HOLDFAST_GAP_SAMPLES @GAP@

/* The preparation: a bias of so many first samples, their mean or median; and how many axes of a
   sensor are turned round (3: all, 1: z alone) where its z begins below -HOLDFAST_TURN_BEYOND. */
#define HOLDFAST_BIAS_ROWS @BIAS_ROWS@
#define HOLDFAST_BIAS_MEDIAN @BIAS_MEDIAN@
#define HOLDFAST_TURNED_AXES @TURNED_AXES@
#define HOLDFAST_TURN_BEYOND @TURN_BEYOND@

/* ---- the step ---- */

enum { HOLDFAST_OK = 0, HOLDFAST_STATE_SIZE = -1, HOLDFAST_STATE_FOREIGN = -2 };

/* A situation; its number grows with the risk. */
enum {
    HOLDFAST_UNKNOWN = -1,
    HOLDFAST_NOTHING = 0,    /* no contact */
    HOLDFAST_GRASP = 1,      /* grasping, or steady holding */
    HOLDFAST_SAFE_SLIP = 2,  /* voluntary: pass, put-down, release; no action wanted */
    HOLDFAST_RISKY_SLIP = 3  /* involuntary: pull, fall; action wanted */
};

/* The memory of one hand. Only holdfast_init makes one; its content is private. */
typedef struct {
    uint32_t model;
    double table[@STATE_NUMBERS@];
} holdfast_state;

/* The answers at one sample. */
typedef struct {
@OUTPUTS@
} holdfast_out;

/* Makes a fresh state. HOLDFAST_STATE_SIZE: this header is not the one that the library was
   compiled with. */
#define holdfast_init(state) holdfast_init_sized((state), sizeof *(state))
int holdfast_init_sized(holdfast_state *state, size_t bytes);

/* One sample [HOLDFAST_CHANNELS]. HOLDFAST_STATE_FOREIGN: the state is not of this model. */
int holdfast_step(holdfast_state *state, const float *sample, holdfast_out *out);

/* The same in double, as the ONNX file takes it; valid [HOLDFAST_SENSORS]: 0 for a lost sensor, 1
   for a good one; NULL: all good. */
int holdfast_step_valid(holdfast_state *state, const double *sample, const uint8_t *valid,
                        holdfast_out *out);

/* The two halves of a step, for tests: from the sample to the features and the flags, and from
   the features (and out->empty, if there is one) to votes, label and probabilities. */
int holdfast_features(holdfast_state *state, const double *sample, const uint8_t *valid,
                      float *features, holdfast_out *out);
void holdfast_answer(const float *features, holdfast_out *out);

/* What a code means, in words; the seal of the model; sizes in this library. */
const char *holdfast_message(int code);
const char *holdfast_digest(void);
size_t holdfast_state_bytes(void);
size_t holdfast_out_bytes(void);

/* ---- the decision: from labels to one request ---- */

/* What the user commands at this sample; both bits may be set. */
typedef int holdfast_wish;
enum { HOLDFAST_NO_WISH = 0, HOLDFAST_OPENING = 1, HOLDFAST_OVERRIDE = 2 };

/* How the last act ended. */
enum {
    HOLDFAST_ENDED_NOT = 0,
    HOLDFAST_ENDED_RELEASED = 1,
    HOLDFAST_ENDED_TIMED_OUT = 2,
    HOLDFAST_ENDED_OPENED = 3,
    HOLDFAST_ENDED_OVERRIDDEN = 4
};

/* Numbers of samples in a row, thousandths of the votes, and ms, from 0 to these bounds; a number
   beyond counts as the bound. */
#define HOLDFAST_MOST_SAMPLES 1000000
#define HOLDFAST_MOST_MS 2000000
typedef struct {
    int32_t arm_samples, act_samples, release_samples, min_risky_permille, override_ms, evidence_ms;
} holdfast_rules;

/* The rules in the model's card. */
extern const holdfast_rules holdfast_own_rules;

/* arm: a risky slip was seen. act: the hand should tighten. Begins as all zero: = {0}. */
typedef struct {
    int32_t risky_run, nothing_run, override_us, evidence_us;
    uint8_t arm, act, ended;
} holdfast_decision;

/* The label that a hand goes by: the situation, or HOLDFAST_UNKNOWN. While a sensor is lost no slip is
   called safe: it is then a risky slip or a grasp, whichever is more probable. */
int holdfast_situation(const holdfast_out *out);

/* After each holdfast_step, with the model's own rules. */
void holdfast_decide(holdfast_decision *decision, const holdfast_out *out, holdfast_wish wish);

/* The same for any rules and label: a situation, or HOLDFAST_UNKNOWN. risky_permille: the risky share
   of the votes in thousandths, as holdfast_risky_permille gives it. */
void holdfast_decide_label(const holdfast_rules *rules, holdfast_decision *decision, int situation,
                           int risky_permille, int32_t period_us, holdfast_wish wish);
int holdfast_risky_permille(const holdfast_out *out);

/* ---- the grip: from answers to one command a sample, by the controller "holdfast" ---- */

/* What may differ from the model's own: copy holdfast_own_options, and change that. _n: N a side. The
   table [rules] of holdfast.toml has the same names. */
typedef struct {
@OPTION_FIELDS@
} holdfast_grip_options;

/* The defaults; forces that are not in N have no ceiling and no target. */
extern const holdfast_grip_options holdfast_own_options;

/* What the controller knows of one sample: forces of either side and along the skin,
   probabilities, flags. A number out of range is brought into it, and a sample with a NaN counts as
   unknown: targets are finite and within the ceiling, whatever is sensed. */
typedef struct {
    double grip_n, load_n, p_risky, p_safe;
    uint8_t known, empty, opening, overridden;
} holdfast_sense;

enum {
    HOLDFAST_IDLE = 0,     /* nothing wanted: the wearer's own grip */
    HOLDFAST_HOLD = 1,     /* keep target_n; without one, the grip that the hand has */
    HOLDFAST_TIGHTEN = 2,
    HOLDFAST_RELAX = 3,    /* give back slowly */
    HOLDFAST_YIELD = 4     /* give back at once */
};

/* target_n: what the hand may add while its wearer does not open it: normal force of either side, 0 for
   none. From the wearer's opening on the hand ignores it, until it has been empty or the wearer closes.
   slew_n_s: no faster than this. feedback: strength of the wearer's vibration cue, 0 to 1. mu_hat,
   margin, needed_n: friction margin, 0 until a slip has shown the friction. */
typedef struct {
    int mode;
    double target_n, slew_n_s, feedback, mu_hat, margin, needed_n;
} holdfast_command;

/* The memory of controller, friction margin and supervisor; its content is private. */
typedef struct {
    holdfast_grip_options options;
    double own_n, ours_n, still_s, held_s, seen_s, quiet_s, last_evidence;
    double mean_used, apart_used, load_n, long_n, behind_n, given_n, risen_s, since_s;
    double last_ratios[@RATIOS@], slid, quiet_ratio, held_ratio;
    double mu_hat, needed_n, holds_n, margin;
} holdfast_grip;

/* options: NULL for the defaults. -1 for one that is no number within its range: then the defaults are
   taken. 0 else. */
int holdfast_grip_init(holdfast_grip *grip, const holdfast_grip_options *options);

/* After holdfast_decide: what was sensed, from the sample's forces. The other fingers of its side stand
   in for a lost one, where the model's hand is known. */
holdfast_sense holdfast_sense_of(const holdfast_out *out, const holdfast_decision *decision,
                                 const double *sample, const uint8_t *valid, holdfast_wish wish);
void holdfast_grip_step(holdfast_grip *grip, const holdfast_sense *sense, holdfast_command *command);

#ifdef __cplusplus
}
#endif
#endif
