/* @TOGETHER@ trees are walked at once: while one waits for memory, the others go on. */
int32_t total[@CLASSES@] = {0};
for (int t = 0; t < @TREES@; t += @TOGETHER@) {
    int32_t at[@TOGETHER@], all = 0;
    for (int k = 0; k < @TOGETHER@; ++k) at[k] = @ROOTS@[t + k];
    /* the sign of the conjunction is negative only where all have reached a leaf, and stay there */
    for (;;) {
        all = -1;
        for (int k = 0; k < @TOGETHER@; ++k) all &= at[k];
        if (all < 0) break;
        for (int k = 0; k < @TOGETHER@; ++k)
            at[k] = hf_next_@KIND@(@BRANCHES@ + @STARTS@[t + k], at[k], @FEATURES@);
    }
    /* the complement of a place below 0 is a leaf; whole votes add up exactly in any order */
    for (int k = 0; k < @TOGETHER@; ++k)
        for (int j = 0; j < @CLASSES@; ++j) total[j] += @LEAVES@[@CLASSES@ * ~at[k] + j];
}
for (int j = 0; j < @CLASSES@; ++j) @VOTES@[j] = (float)total[j];
