/* ---- the controller "holdfast" (holdfast/edge_runtime/grip.py) ---- */

#define HF_PERIOD_S (1.0 / HOLDFAST_RATE_HZ)

/* The grip that the wearer set. One under a target says nothing about it. */
static void hf_step_own_grip(holdfast_grip *own, const holdfast_sense *sense) {
    const double share = 1.0 / (1.0 + HF_OWN_S * HOLDFAST_RATE_HZ);
    const double back = 1.0 / (1.0 + HF_BACK_S * HOLDFAST_RATE_HZ);
    const double rise_n = sense->grip_n - own->own_n;
    const int rises = rise_n > HF_RISES_N + HF_RISES_SHARE * own->own_n;
    const int again =
        rise_n > HF_AGAIN_N + HF_AGAIN_SHARE * own->own_n && sense->p_risky < HF_SLIP_P;
    int is_ours;
    own->ours_n = hf_high(own->given_n, own->ours_n + back * (own->given_n - own->ours_n));
    is_ours = own->ours_n > HF_OURS_N &&
              sense->grip_n < HF_OURS_TIMES * own->ours_n + HF_OURS_N;
    own->held_s = hf_low(own->held_s + HF_PERIOD_S, HF_MOST_S); /* also while the state is unknown */
    if (!sense->known) return;
    own->seen_s = hf_low(own->seen_s + HF_PERIOD_S, HF_MOST_S);
    if (again && !is_ours) own->held_s = own->seen_s = 0.0;
    own->still_s = rises && !is_ours ? 0.0 : hf_low(own->still_s + HF_PERIOD_S, HF_MOST_S);
    if (!is_ours) own->own_n = own->own_n + share * rise_n;
    if (sense->empty) own->own_n = own->ours_n = own->still_s = own->held_s = own->seen_s = 0.0;
}

/* Whether the wearer's hand still closes on its object. */
static int hf_closes(const holdfast_grip *own) {
    return own->still_s < HF_STILL_S && own->held_s < HF_CLOSES_S;
}

/* The share of friction in use, and what was usual on it before; makes: the wearer still makes the hold. */
typedef struct {
    double used, usual;
    int makes;
} hf_friction;

/* Take one sample, and learn from it what is usual. */
static hf_friction hf_step_use(holdfast_grip *own, const holdfast_sense *sense) {
    const double used = sense->load_n / (2.0 * hf_high(sense->grip_n, HF_LEAST_GRIP_N));
    const double usual = own->mean_used + HF_TIMES_APART * own->apart_used;
    const int makes = hf_closes(own) || own->seen_s < HF_LEARNS_S;
    const double share = 1.0 / (1.0 + (makes ? HF_QUICK_S : HF_MEAN_S) * HOLDFAST_RATE_HZ);
    const double quick = 1.0 / (1.0 + HF_LOAD_S * HOLDFAST_RATE_HZ);
    const double slow = 1.0 / (1.0 + HF_LONG_S * HOLDFAST_RATE_HZ);
    const double apart = hf_high(used - own->mean_used, own->mean_used - used);
    const hf_friction now = {used, usual, makes};
    if (!sense->known) return now;
    if (sense->empty) {
        own->mean_used = own->apart_used = own->load_n = own->long_n = 0.0;
        return now;
    }
    own->load_n = own->load_n + quick * (sense->load_n - own->load_n);
    own->long_n = own->long_n + slow * (sense->load_n - own->long_n);
    if (makes || (own->given_n <= 0.0 && !(own->load_n > HF_LOAD_RISES * own->long_n))) {
        own->mean_used = own->mean_used + share * (used - own->mean_used);
        own->apart_used = own->apart_used + share * (apart - own->apart_used);
    }
    return now;
}

/* How far evidence counts, 0 to 1: in a young hold as far as friction in use has risen. */
static double hf_counts(const holdfast_grip *own, const hf_friction *friction) {
    const double usual = hf_high(friction->usual, HF_LEAST_USUAL);
    double risen = (friction->used - usual) / (HF_FULL_OVER * usual);
    if (!(own->held_s < HF_YOUNG_S)) return 1.0;
    if (friction->makes) return 0.0;
    risen = risen > 0.0 ? risen : 0.0;
    return risen < 1.0 ? risen : 1.0;
}

/* 0 to 1. */
static double hf_evidence(const holdfast_grip *own, const holdfast_sense *sense) {
    const double from_p = own->options.from_p, full_p = own->options.full_p;
    double share = (sense->p_risky - from_p) / (full_p - from_p);
    share = share > 0.0 ? share : 0.0;
    return share < 1.0 ? share : 1.0;
}

/* The grip to keep without evidence: brake first, then stay where the grip is. */
static double hf_kept_n(const holdfast_grip *own, const holdfast_sense *sense) {
    const int braking = own->quiet_s < HF_BRAKE_S;
    const int stops = !braking && own->quiet_s < HF_BRAKE_S + HF_PERIOD_S;
    const double back_n = hf_high(own->own_n > 0.0 ? own->own_n : sense->grip_n, own->needed_n);
    double kept_n = stops ? hf_high(sense->grip_n, own->own_n) : own->given_n;
    kept_n = hf_high(kept_n, own->needed_n);
    kept_n = braking ? back_n : kept_n > own->own_n ? kept_n : 0.0;
    return own->given_n > 0.0 ? kept_n : 0.0;
}

/* The answer to a slip, N a side; 0 for none. */
static double hf_answer_slip(holdfast_grip *own, const holdfast_sense *sense,
                             const hf_friction *friction, int *fresh) {
    const int holds = sense->known && !sense->empty;
    const double now = holds ? hf_counts(own, friction) * hf_evidence(own, sense) : 0.0;
    const double fading = own->last_evidence - HF_PERIOD_S / HF_FADES_S;
    const double evidence = holds ? hf_high(now, fading) : 0.0;
    const double most_n = hf_high(own->own_n + own->options.rise_n, own->needed_n);
    double wanted_n = hf_high(sense->grip_n, own->own_n) + own->options.lead_n * evidence;
    *fresh = evidence > 0.0;
    if (!(sense->grip_n < most_n)) wanted_n = most_n;
    if (!*fresh) wanted_n = hf_kept_n(own, sense);
    if (sense->known) {
        own->last_evidence = evidence;
        own->quiet_s = *fresh ? 0.0 : hf_low(own->quiet_s + HF_PERIOD_S, 1.0);
    }
    return wanted_n;
}

/* The grip that a load which rises asks for, N a side; 0 where it does not rise. */
static double hf_follow_load(holdfast_grip *own, const holdfast_sense *sense,
                             const hf_friction *friction) {
    const holdfast_grip_options *const rules = &own->options;
    const double floor = rules->floor * (hf_gain(own, HF_ASSUMED_GAIN) / HF_ASSUMED_GAIN);
    const double reference = hf_high(friction->usual, floor);
    const double within_n = sense->p_safe >= rules->safe_p ? rules->safe_follow_n : rules->follow_n;
    const double most_n = hf_low(within_n, HF_MOST_FOLLOW_N + HF_MOST_TIMES * own->own_n);
    const double allowed = rules->above * reference;
    const int holds = sense->known && !sense->empty && !friction->makes;
    const int rises = holds && friction->used > HF_FOLLOW_STARTS * allowed;
    const double share = 1.0 / (1.0 + HF_RATE_S * HOLDFAST_RATE_HZ);
    const double behind_n = own->behind_n + share * (sense->load_n - own->behind_n);
    const double ahead_n = sense->load_n + HF_AHEAD_TIMES * hf_high(sense->load_n - behind_n, 0.0);
    if (sense->known) own->behind_n = behind_n;
    return rises && most_n > 0.0 ? hf_low(ahead_n / (2.0 * allowed), own->own_n + most_n) : 0.0;
}

/* The wanted grip, N a side; 0 for none. */
static double hf_step_controller(holdfast_grip *own, const holdfast_sense *sense, int *fresh) {
    double wanted_n, asked_n, most_n;
    hf_friction friction;
    hf_step_own_grip(own, sense);
    friction = hf_step_use(own, sense);
    wanted_n = hf_answer_slip(own, sense, &friction, fresh);
    asked_n = hf_follow_load(own, sense, &friction);
    if (asked_n > 0.0) *fresh = 1;
    /* while the hand closes no sensor tells the wearer's grip from ours */
    if (hf_closes(own)) {
        *fresh = 0;
        return 0.0;
    }
    most_n = hf_low(own->held_s < HF_EARLY_S ? HF_EARLY_N : (double)INFINITY, own->options.most_over_n);
    return hf_low(hf_high(wanted_n, asked_n), own->own_n + most_n);
}
