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

/* Whether the load has fallen by more than the hand's tremor can take from it. */
static int hf_beyond_tremor(holdfast_grip *own, double load_n) {
    const double leak = 1.0 / (1.0 + HF_PERIOD_OF_TREMOR_S * HOLDFAST_RATE_HZ);
    const double forgets = 1.0 / (1.0 + HF_MEMORY_S * HOLDFAST_RATE_HZ);
    const double share = 1.0 / (1.0 + HF_SMOOTH_S * HOLDFAST_RATE_HZ);
    const double smooth_n = own->load_n + share * (load_n - own->load_n);
    const double high_n = hf_high(smooth_n, own->high_n + leak * (smooth_n - own->high_n));
    const double low_n = hf_low(smooth_n, own->low_n + leak * (smooth_n - own->low_n));
    const double fall_n = high_n - smooth_n;
    const double rise_n = smooth_n - low_n;
    const double mean_n = own->mean_n + leak * (smooth_n - own->mean_n);
    const double most_n = hf_high(mean_n, own->most_n + forgets * (mean_n - own->most_n));
    const double least_n = hf_high(HF_SWING_SHARE * hf_high(high_n, most_n), HF_LEAST_SWING_N);
    const int gone = most_n - mean_n > hf_high(HF_SWING_GONE * most_n, HF_LEAST_SWING_N);
    const int beyond_fall = fall_n > HF_TIMES_TREMOR * own->rises_n + least_n;
    own->load_n = smooth_n;
    own->high_n = high_n;
    own->low_n = low_n;
    own->rises_n = hf_high(rise_n, own->rises_n - forgets * own->rises_n);
    own->mean_n = mean_n;
    own->most_n = most_n;
    return beyond_fall || gone;
}

/* Whether the evidence says hand-over: safe slip, while the load changes. */
static int hf_handed_over(holdfast_grip *own, const holdfast_sense *sense) {
    if (sense->known) {
        const int beyond = hf_beyond_tremor(own, sense->load_n);
        own->safe_run = beyond && sense->p_safe > HF_YIELD_P ? own->safe_run + 1.0 : 0.0;
    }
    return own->safe_run >= HF_YIELD_SAMPLES;
}

/* The wanted grip, N a side; 0 for none. */
static double hf_step_controller(holdfast_grip *own, const holdfast_sense *sense, int *fresh) {
    const int holds = sense->known && !sense->empty;
    const double now = holds ? hf_evidence(sense) : 0.0;
    const double fading = own->last_evidence - HF_PERIOD_S / HF_FADES_S;
    const double evidence = holds ? hf_high(now, fading) : 0.0;
    double most_n, ahead_n, wanted_n;
    int ends;
    hf_step_own_grip(own, sense);
    *fresh = evidence > 0.0;
    most_n = hf_high(own->own_n + HF_RISE_N, own->needed_n);
    ahead_n = hf_high(sense->grip_n, own->own_n) + own->options.lead_n * evidence;
    if (!(sense->grip_n < most_n)) ahead_n = most_n;
    wanted_n = *fresh ? ahead_n : hf_kept_n(own, sense);
    ends = hf_handed_over(own, sense) && !(now > 0.0);
    if (sense->known) own->last_evidence = evidence;
    if (ends) own->last_evidence = 0.0;
    if (sense->known) own->quiet_s = *fresh ? 0.0 : hf_low(own->quiet_s + HF_PERIOD_S, 1.0);
    return ends ? 0.0 : wanted_n;
}
