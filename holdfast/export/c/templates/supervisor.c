/* ---- the supervisor (holdfast/edge_runtime/supervisor.py) ---- */

/* Time since the last evidence; it stands still while the state is unknown. */
static void hf_pass_time(holdfast_grip *own, const holdfast_sense *sense, int fresh) {
    const double later_s = hf_low(own->since_s + HF_PERIOD_S, own->options.give_back_s);
    if (sense->known) own->since_s = fresh ? 0.0 : later_s;
}

/* The wanted grip, where the target may go there. */
static double hf_followed(const holdfast_grip *own, double wanted_n) {
    const int may_rise = own->since_s < own->options.rise_s && own->risen_s < own->options.most_rise_s;
    /* what no controller can want changes nothing; only NaN differs from itself */
    const double possible_n = wanted_n == wanted_n ? wanted_n : own->given_n;
    const double capped_n = hf_low(hf_high(possible_n, 0.0), own->options.ceiling_n);
    return may_rise ? capped_n : hf_low(capped_n, own->given_n);
}

/* The target after slow relaxing to the grip that holds. */
static double hf_given_back(const holdfast_grip *own, double target_n) {
    const double less_n = target_n - own->options.give_back_n_s * HF_PERIOD_S;
    const double floor_n = hf_low(own->holds_n, target_n);
    if (own->since_s < own->options.give_back_s) return target_n;
    return hf_high(hf_high(less_n, floor_n), 0.0);
}

static int hf_mode(double before_n, double target_n, int unknown, int ends) {
    const int none = before_n > 0.0 ? HOLDFAST_YIELD : HOLDFAST_IDLE;
    if (ends) return none;
    if (unknown) return HOLDFAST_HOLD;
    if (target_n <= 0.0) return none;
    if (target_n > before_n) return HOLDFAST_TIGHTEN;
    return target_n < before_n ? HOLDFAST_RELAX : HOLDFAST_HOLD;
}

static int hf_supervise(holdfast_grip *own, const holdfast_sense *sense, double wanted_n, int fresh) {
    const int ends = sense->opening || sense->overridden || (sense->known && sense->empty);
    double target_n;
    int mode;
    hf_pass_time(own, sense, fresh);
    target_n = hf_given_back(own, hf_followed(own, wanted_n));
    if (!sense->known) target_n = own->given_n;
    if (ends) target_n = 0.0;
    if (target_n > own->given_n) own->risen_s = own->risen_s + HF_PERIOD_S;
    if (target_n <= 0.0 || own->since_s >= own->options.give_back_s) own->risen_s = 0.0;
    mode = hf_mode(own->given_n, target_n, !sense->known, ends);
    own->given_n = target_n;
    return mode;
}
