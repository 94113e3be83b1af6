/* Limits of rig.yaml, written by `python -m plate_sim.device.limits_header`. Change rig.yaml, not this
   file. */
static const Limits LIMITS = {
    .stroke_m = 0.01f,
    .speed = 1.0f,
    .accel = 100.0f,
    .force = 200.0f,
    .continuous_force = 100.0f,
    .heat_s = 60.0f,
    .load = {
        {0.575f, 0.425f, 0.15f, -0.15f},
        {0.425f, 0.575f, -0.15f, 0.15f},
        {0.15f, -0.15f, 0.8f, 0.2f},
        {-0.15f, 0.15f, 0.2f, 0.8f},
    },
    .following_m = 0.003f,
};
