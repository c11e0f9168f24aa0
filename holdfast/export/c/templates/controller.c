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

/* Whether the evidence says hand-over: safe slip, while the load changes. */
static int hf_handed_over(holdfast_grip *own, const holdfast_sense *sense) {
    const double share = 1.0 / (1.0 + HF_CHANGE_S * HOLDFAST_RATE_HZ);
    const double load_n = sense->known ? sense->load_n : own->load_n;
    const double change_n_s = (load_n - own->load_n) * HOLDFAST_RATE_HZ;
    own->load_n = load_n;
    if (sense->known) {
        int moving;
        own->change_n_s = own->change_n_s + share * (change_n_s - own->change_n_s);
        moving = own->change_n_s > HF_MOVING_N_S || own->change_n_s < -HF_MOVING_N_S;
        own->safe_run = moving && sense->p_safe > HF_YIELD_P ? own->safe_run + 1.0 : 0.0;
    }
    return own->safe_run >= HF_YIELD_SAMPLES;
}

/* The wanted grip, N a side; 0 for none. */
static double hf_step_controller(holdfast_grip *own, const holdfast_sense *sense, int *fresh) {
    double evidence, wanted_n;
    int ends;
    hf_step_own_grip(own, sense);
    evidence = hf_evidence(sense);
    *fresh = evidence > 0.0 && sense->known && !sense->empty;
    wanted_n = *fresh ? hf_high(sense->grip_n, own->own_n) + own->options.lead_n * evidence
                      : hf_kept_n(own, sense);
    ends = hf_handed_over(own, sense) && !*fresh;
    if (sense->known) own->quiet_s = *fresh ? 0.0 : hf_low(own->quiet_s + HF_PERIOD_S, 1.0);
    return ends ? 0.0 : wanted_n;
}
