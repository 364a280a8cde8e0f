def corrected(correction_kw, desired_kw, metered_kw, is_free, rating_kw, cycle_s):
    if is_free: return 0.0
    return min(max(correction_kw + 0.5*min(cycle_s,1.0)*(desired_kw-metered_kw),0.0),0.1*rating_kw)
