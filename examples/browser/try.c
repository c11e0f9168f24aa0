/* The page's world in WebAssembly: at each sample fingertips are sensed, the hand of hand.c answers, and the
   physics of scene.c goes on to the next sample with the grip that follows. The page writes the setup, calls
   `start`, then `advance` once a sample, and says in between what wearer and people do. */
#include "hand.c"
#include "scene.c"

enum { PIECES = 8, AVERAGED = 3, GIVER = 0, TAKER = 1, PULLER = 2, PEOPLE = 3 };
static const double NEVER_S = 1e9, OPEN_GAP_M = 0.03, CLOSING_S = 0.4, OPENING_S = 0.4;
static const double GIVER_N_PER_M = 800.0, TAKER_N_PER_M = 300.0, PULLER_N_PER_M = 150.0, DAMPING_RATIO = 0.7;
static const double GIVER_CAP_N = 40.0, PULLER_CAP_N = 20.0, TAKER_CAP_N = 8.0, TAKES_S = 0.4, MOVES_S = 1.5, TAKES_M = 0.2;
/* of a sensor along the skin and across it, as in the thesis' scene: noise (sd), smallest step, largest bias */
static const double NOISE_N[2] = {0.012, 0.015}, STEP_N[2] = {0.0107, 0.0386}, BIAS_N[2] = {0.5, 0.2};
static const double REACH_PER_S = 15.0, FASTEST_M_S = 0.8; /* how a person's arm follows the pointer */

/* What the page writes before it starts: examples/browser/setups.py makes it, all double. */
typedef struct {
    scene_body body;
    double share[SCENE_CONTACTS], lag_s, fastest_n_s, ceiling_n, backlash_n, grip_n;
} try_setup;

/* What the page reads after a sample, all double. people_n: force of the people on the object. */
typedef struct {
    double t_s, position_m[3], people_n[3], pull_n[3], grip_n, own_n, target_n, load_n, sensed_n, touching, sliding;
    double gap_m, supports, takes; /* how far the hand is open; how far those people are there, 0 .. 1 */
} try_view;

static try_setup set;
static try_view view;
static scene_state world;
static scene_drive drive;
static double gives_s, giving_s, takes_s, opens_s, pulled_m[3], pulled_m_s[3], goal_m[3];
static double felt_n[C], bias_n[C];
static int pulls;
static uint64_t random_bits;

/* 0 .. 1 (Marsaglia, "Xorshift RNGs", 2003). */
static double uniform(void) {
    random_bits ^= random_bits << 13;
    random_bits ^= random_bits >> 7;
    random_bits ^= random_bits << 17;
    return (double)(random_bits >> 11) / 9007199254740992.0;
}

/* Nearly normal, mean 0, sd 1: a sum of twelve. */
static double normal(void) {
    double total = -6.0;
    for (int k = 0; k < 12; ++k) total += uniform();
    return total;
}

EXPORTED(setup) double *setup(void) { return (double *)&set; }
EXPORTED(setup_count) int setup_count(void) { return (int)(sizeof set / sizeof(double)); }
EXPORTED(seen) const double *seen(void) { return (const double *)&view; }
EXPORTED(seen_count) int seen_count(void) { return (int)(sizeof view / sizeof(double)); }

/* What people and wearer do from now on. */
EXPORTED(let_go) void let_go(double lasts_s) { gives_s = view.t_s, giving_s = lasts_s; }
EXPORTED(take_over) void take_over(void) { takes_s = view.t_s; }
EXPORTED(open_hand) void open_hand(void) { opens_s = smaller(opens_s, view.t_s); }
EXPORTED(release) void release(void) { pulls = 0; }
EXPORTED(pull_to) void pull_to(double x_m, double y_m, double z_m) {
    for (int k = 0; k < 3 && !pulls; ++k) pulled_m[k] = world.position_m[k], pulled_m_s[k] = 0.0;
    pulls = 1;
    goal_m[0] = x_m, goal_m[1] = y_m, goal_m[2] = z_m;
}

/* How far the wearer, and then the drive, closes each finger, as LoopScript; returns the wearer's grip. */
static double wearers_closure(double t_s, double *closure_m) {
    const double shut = scene_smooth((t_s - 1.0) / CLOSING_S) - scene_smooth((t_s - opens_s) / OPENING_S);
    double least = INFINITY;
    for (int i = 0; i < SCENE_CONTACTS; ++i) {
        const double closed_m = set.grip_n * set.share[i] / set.body.stiffness_n_per_m[i];
        closure_m[i] = shut * (OPEN_GAP_M + closed_m) - OPEN_GAP_M;
        least = smaller(least, closure_m[i] / closed_m);
    }
    return shut == 1.0 ? set.grip_n : least * set.grip_n;
}

static void drivens_closure(double *closure_m) {
    for (int i = 0; i < SCENE_CONTACTS; ++i) {
        const double drive_m = drive.place_n * set.share[i] / set.body.stiffness_n_per_m[i];
        if (drive.place_n > drive.own_n) closure_m[i] = larger(closure_m[i], drive_m);
    }
}

static scene_person person(double there, double n_per_m, double cap_n, double weight_share) {
    scene_person one = {0};
    one.stiffness_n_per_m = there * n_per_m;
    one.damping_n_s_per_m = there * 2.0 * DAMPING_RATIO * sqrt(n_per_m * set.body.mass_kg);
    one.cap_n = there * cap_n + 1e-9;
    one.weight_share = weight_share;
    return one;
}

/* The arm of whoever pulls goes after the pointer, critically damped and no faster than an arm. */
static void reach(double dt_s) {
    for (int k = 0; k < 3; ++k) {
        const double to_go_m = goal_m[k] - pulled_m[k];
        pulled_m_s[k] += dt_s * REACH_PER_S * (REACH_PER_S * to_go_m - 2.0 * pulled_m_s[k]);
        pulled_m_s[k] = within(pulled_m_s[k], -FASTEST_M_S, FASTEST_M_S);
        pulled_m[k] += dt_s * pulled_m_s[k];
    }
}

static void act(double t_s, double dt_s, scene_person *people) {
    const double there = 1.0 - scene_smooth((t_s - gives_s) / giving_s);
    const double u = within((t_s - takes_s - TAKES_S) / MOVES_S, 0.0, 1.0);
    const double taken = scene_smooth((t_s - takes_s) / TAKES_S), path[3] = {0.0, 0.5, 0.8660254037844386};
    people[GIVER] = person(there, GIVER_N_PER_M, GIVER_CAP_N, there);
    people[TAKER] = person(t_s >= takes_s, TAKER_N_PER_M, TAKER_CAP_N, taken);
    people[PULLER] = person(pulls, PULLER_N_PER_M, PULLER_CAP_N, 0.0);
    if (pulls) reach(dt_s);
    for (int k = 0; k < 3; ++k) {
        people[TAKER].target_m[k] = TAKES_M * scene_smooth(u) * path[k];
        people[TAKER].target_m_s[k] = TAKES_M / MOVES_S * 30.0 * u * u * (1.0 - u) * (1.0 - u) * path[k];
        people[PULLER].target_m[k] = pulled_m[k];
        people[PULLER].target_m_s[k] = pulled_m_s[k];
    }
}

/* The samples of the six fingertips: forces with bias and noise, in whole steps. */
static void sense_fingers(void) {
    view.sensed_n = view.load_n = view.touching = view.sliding = 0.0;
    for (int k = 0; k < C; ++k) {
        const int normal_axis = k % 3 == 2;
        const double read_n = felt_n[k] + bias_n[k] + NOISE_N[normal_axis] * normal();
        sample[k] = floor(read_n / STEP_N[normal_axis] + 0.5) * STEP_N[normal_axis];
    }
    for (int i = 0; i < SCENE_CONTACTS; ++i) {
        const double *force_n = felt_n + 3 * i;
        valid[i] = 1;
        view.load_n += sqrt(force_n[0] * force_n[0] + force_n[1] * force_n[1]);
        view.sensed_n += 0.5 * force_n[2];
        view.touching += world.normal_n[i] > 0.0;
        for (int e = 0; e < SCENE_ELEMENTS; ++e)
            view.sliding += world.normal_n[i] > 0.0 && world.slip_m_s[e][i] > 2e-4;
    }
}

static void note(double target_n, const double *closure_m, const scene_person *people) {
    double squares = 0.0;
    for (int k = 0; k < 3; ++k) {
        view.position_m[k] = world.position_m[k];
        view.people_n[k] = world.agents_n[k];
        view.pull_n[k] = people[PULLER].stiffness_n_per_m * (pulled_m[k] - world.position_m[k]);
        squares += view.pull_n[k] * view.pull_n[k];
    }
    for (int k = 0; k < 3; ++k) view.pull_n[k] *= smaller(1.0, PULLER_CAP_N / larger(sqrt(squares), TINY));
    view.gap_m = larger(-closure_m[0], 0.0);
    view.supports = people[GIVER].weight_share;
    view.takes = people[TAKER].weight_share;
    view.grip_n = larger(drive.place_n, 0.0);
    view.own_n = larger(drive.own_n, 0.0);
    view.target_n = target_n;
}

/* A new trial of what the setup holds: an open hand, and a person who holds the object in it. */
EXPORTED(start) int start(double seed) {
    static const try_view fresh;
    double closure_m[SCENE_CONTACTS];
    random_bits = 0x9E3779B97F4A7C15u ^ (uint64_t)seed;
    view = fresh;
    pulls = 0;
    gives_s = takes_s = opens_s = NEVER_S;
    giving_s = 1.0;
    for (int k = 0; k < C; ++k) felt_n[k] = 0.0, bias_n[k] = BIAS_N[k % 3 == 2] * (2.0 * uniform() - 1.0);
    drive.lag_s = set.lag_s;
    drive.fastest_n_s = set.fastest_n_s;
    drive.ceiling_n = set.ceiling_n;
    drive.backlash_n = set.backlash_n;
    drive.own_n = drive.motor_n = drive.place_n = wearers_closure(0.0, closure_m);
    drive.speed_n_s = 0.0;
    scene_rest(&set.body, closure_m, &world);
    return C == 3 * SCENE_CONTACTS ? begin() : HOLDFAST_STATE_SIZE;
}

/* One sample, and the physics until the next. helped: the drive obeys the answer, else the wearer alone. From the
   wearer's opening on the hand ignores every target, and the answer is not even told. */
EXPORTED(advance) int advance(int helped) {
    const double dt_s = 1.0 / (HOLDFAST_RATE_HZ * PIECES);
    double closure_m[SCENE_CONTACTS], forces_n[C];
    scene_person people[PEOPLE];
    sense_fingers();
    if (feed(1.0) != 0) return 1;
    for (int k = 0; k < C; ++k) felt_n[k] = 0.0;
    for (int piece = 1; piece <= PIECES; ++piece) {
        const double t_s = view.t_s + piece * dt_s, target_n = helped && t_s < opens_s ? command.target_n : 0.0;
        scene_drive_step(&drive, target_n, wearers_closure(t_s, closure_m), dt_s);
        drivens_closure(closure_m);
        act(t_s, dt_s, people);
        scene_step(&set.body, &world, closure_m, people, PEOPLE, dt_s);
        scene_forces(&set.body, &world, forces_n);
        for (int k = 0; k < C && piece > PIECES - AVERAGED; ++k) felt_n[k] += forces_n[k] / AVERAGED;
    }
    note(helped ? command.target_n : 0.0, closure_m, people);
    view.t_s += 1.0 / HOLDFAST_RATE_HZ;
    return 0;
}
