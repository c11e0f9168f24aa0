/* ---- the controller "holdfast" (holdfast/edge_runtime/grip.py) ---- */

#define HF_PERIOD_S (1.0 / HOLDFAST_RATE_HZ)

/* The grip that the wearer set; it stands still while a target is given. */
static void hf_step_own_grip(holdfast_grip *own, const holdfast_sense *sense) {
    const double share = 1.0 / (1.0 + HF_OWN_S * HOLDFAST_RATE_HZ);
    if (own->given_n <= 0.0 && sense->known) {
        own->own_n = sense->empty ? 0.0 : own->own_n + share * (sense->grip_n - own->own_n);
    }
}

/* 0 to 1. */
static double hf_evidence(const holdfast_sense *sense) {
    double share = (sense->p_risky - HF_FROM_P) / (HF_FULL_P - HF_FROM_P);
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
static double hf_answer_slip(holdfast_grip *own, const holdfast_sense *sense, int *fresh) {
    const int holds = sense->known && !sense->empty;
    const double now = holds ? hf_evidence(sense) : 0.0;
    const double fading = own->last_evidence - HF_PERIOD_S / HF_FADES_S;
    const double evidence = holds ? hf_high(now, fading) : 0.0;
    const double most_n = hf_high(own->own_n + HF_RISE_N, own->needed_n);
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

/* Mean and deviation of the share of friction in use, while no target was given. */
static void hf_learn_use(holdfast_grip *own, const holdfast_sense *sense, double used) {
    const double share = 1.0 / (1.0 + HF_MEAN_S * HOLDFAST_RATE_HZ);
    const double apart = hf_high(used - own->mean_used, own->mean_used - used);
    if (!sense->known) return;
    if (sense->empty) {
        own->mean_used = own->apart_used = 0.0;
    } else if (own->given_n <= 0.0) {
        own->mean_used = own->mean_used + share * (used - own->mean_used);
        own->apart_used = own->apart_used + share * (apart - own->apart_used);
    }
}

/* The grip that a load which rises asks for, N a side; 0 where it does not rise. */
static double hf_follow_load(holdfast_grip *own, const holdfast_sense *sense) {
    const double used = sense->load_n / (2.0 * hf_high(sense->grip_n, HF_LEAST_GRIP_N));
    const double usual = own->mean_used + HF_TIMES_APART * own->apart_used;
    const double reference = hf_high(usual, HF_FLOOR);
    const int rises = sense->known && !sense->empty && used > HF_ABOVE * reference &&
                      sense->p_safe < HF_SAFE_P;
    hf_learn_use(own, sense, used);
    return rises ? sense->load_n / (2.0 * reference) : 0.0;
}

/* The wanted grip, N a side; 0 for none. */
static double hf_step_controller(holdfast_grip *own, const holdfast_sense *sense, int *fresh) {
    double wanted_n, asked_n;
    hf_step_own_grip(own, sense);
    wanted_n = hf_answer_slip(own, sense, fresh);
    asked_n = hf_low(hf_follow_load(own, sense), own->own_n + HF_FOLLOW_N);
    if (asked_n > 0.0) *fresh = 1;
    return hf_low(hf_high(wanted_n, asked_n), own->own_n + own->options.most_over_n);
}
