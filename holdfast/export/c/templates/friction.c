/* ---- the friction margin (holdfast/edge_runtime/grip_control.py) ---- */

static double hf_low(double a, double b) { return a < b ? a : b; }

static double hf_high(double a, double b) { return a > b ? a : b; }

/* A sample of friction, where the ratio stands still while a slip is all but certain. */
static void hf_take_ratio(holdfast_grip *own, const holdfast_sense *sense, double ratio) {
    double low, high;
    ratio = sense->known && sense->p_risky > HF_SURE_P ? ratio : 0.0;
    low = high = ratio;
    for (int k = 0; k < HF_RATIOS - 1; ++k) {
        low = hf_low(low, own->last_ratios[k]);
        high = hf_high(high, own->last_ratios[k]);
    }
    if (high - low < HF_STEADY * high) own->slid = hf_high(own->slid, low);
    for (int k = HF_RATIOS - 2; k > 0; --k) own->last_ratios[k] = own->last_ratios[k - 1];
    own->last_ratios[0] = ratio;
}

/* The largest ratio that was held in quiet. */
static void hf_hold_ratio(holdfast_grip *own, const holdfast_sense *sense, double ratio, int firm) {
    const double share = 1.0 / (1.0 + HF_QUIET_S * HOLDFAST_RATE_HZ);
    if (firm && sense->p_risky < HF_QUIET_P && sense->p_safe < HF_QUIET_P) {
        own->quiet_ratio = own->quiet_ratio + share * (ratio - own->quiet_ratio);
        own->held_ratio = hf_high(own->held_ratio, own->quiet_ratio);
    }
}

/* mu_hat, margin and the needed grip after this sample. */
static void hf_conclude(holdfast_grip *own, const holdfast_sense *sense, double load_n, int firm) {
    const int sure = own->slid > 0.0;
    const double lower = hf_high(hf_high(own->slid, own->held_ratio), HF_LEAST_MU);
    const double slides_n = load_n / (2.0 * lower);
    own->mu_hat = sure ? lower : 0.0;
    own->needed_n = sure ? HF_SPARE * slides_n : 0.0;
    own->holds_n = sure ? own->needed_n : slides_n;
    own->margin = sure && firm ? 1.0 - slides_n / hf_high(sense->grip_n, HF_FIRM_N) : 0.0;
}

/* The gain in the options, or `unknown` where it was not measured. */
static double hf_gain(const holdfast_grip *own, double unknown) {
    return own->options.shear_gain > 0.0 ? own->options.shear_gain : unknown;
}

static void hf_step_friction(holdfast_grip *own, const holdfast_sense *sense) {
    const int firm = sense->grip_n > HF_FIRM_N && sense->known;
    const double load_n = sense->load_n / hf_gain(own, 1.0);
    const double ratio = firm ? load_n / (2.0 * hf_high(sense->grip_n, HF_FIRM_N)) : 0.0;
    hf_take_ratio(own, sense, ratio);
    hf_hold_ratio(own, sense, ratio, firm);
    if (sense->empty && sense->known) own->slid = own->quiet_ratio = own->held_ratio = 0.0;
    hf_conclude(own, sense, load_n, firm);
}
