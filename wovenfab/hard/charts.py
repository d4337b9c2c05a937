def draw_large_steps(f, p):
    return p


draw_locking = draw_tunnelling = draw_contrasts = draw_meshes = draw_scales = draw_long = (
    draw_failures
) = draw_large_steps
