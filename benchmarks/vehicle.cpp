// The equations of tricycle_sim/vehicle/kernel.py by hand in C++, eight vehicles per vector: the yardstick
// of benchmarks/vehicle.py, which builds and calls it and puts the rows into its order. It
// leaves out what the Python kernel does besides (watching for events, ending rolled-over runs).
#include <cmath>

using V = double __attribute__((vector_size(64)));

static inline V root(V x) {
    V y;
    for (int i = 0; i < 8; ++i) y[i] = std::sqrt(x[i]);
    return y;
}
static inline V larger(V x, V y) { return x > y ? x : y; }
static inline V smaller(V x, V y) { return x < y ? x : y; }
static inline V all(double x) { return V{} + x; }

enum Row {
    X, Y, Z, Q0, Q1, Q2, Q3, U, V_, W, P, Q, R, SPIN, KAPPA = SPIN + 3, ALPHA = KAPPA + 3,
    TORQUE = ALPHA + 3, INTEGRATOR, STATES, START = STATES, SUM = 2 * STATES, SLOPE = 3 * STATES
};

// constants: body and places of the wheels, tyre, its law, motor, brake
enum Constant {
    GRAVITY_Z, INVERSE_MASS, DRAG_PER_MASS, IXX, IYY, IZZ, INVERSE_IXX, INVERSE_IYY, INVERSE_IZZ,
    FRONT_X, REAR_X, LEFT_Y, RIGHT_Y, REAR_Y, WHEEL_Z, IW_FRONT, IW_REAR, INVERSE_IW_FRONT,
    INVERSE_IW_REAR, KING_PIN_X, KING_PIN_Z, ROLLOVER_COSINE, GRAVITY_X, GRAVITY_Y,
    KZ, CZ, RADIUS, INVERSE_SIGMA_X, INVERSE_SIGMA_Y, V0_SQUARED, INVERSE_V0, F1, F2, V_EPS_SQUARED,
    C_KAPPA, C_ALPHA, C_GAMMA, SAP, MU, LS0, LS1, VL_SQUARED, DX, DY,
    MOTOR_TORQUE, MOTOR_POWER, MOTOR_SLOPE, NO_LOAD_SPEED, REGENERATIVE, INVERSE_LAG, KP, KI,
    ANTI_WINDUP, MOTOR_RADIUS, BRAKE_TORQUE, BRAKE_STIFFNESS
};

static inline V arctan(V t) {
    static const double coefficients[] = {
        -1.93423475928923e-05, 0.00021423810738603946, -0.0011252544302234645,
        0.003751138483965141, -0.00899108054265826, 0.01671959606350739, -0.02556862364437174,
        0.03387126702700675, -0.040811247503178855, 0.04668745304848529, -0.052374234719188166,
        0.058768281144872724, -0.06665764910689723, 0.07692198997458294, -0.09090899793217341,
        0.11111110578002083, -0.14285714266926733, 0.1999999999964796, -0.333333333333307, 1.0};
    V z = t * t, even = all(coefficients[0]);
    for (int i = 1; i < 20; ++i) even = even * z + coefficients[i];
    return t * even;
}

struct Wrench { V fx, fy, fz, mx, my, mz; };

static inline Wrench wheel(V* g, const V* c, int wheel, V ex, V ey, V ez, V nx, V ny, V nz, V rate,
                           V px, V py, V pz, V inertia, V inverse_inertia, V drive_torque,
                           double brake) {
    V u = g[U], v = g[V_], w = g[W], p = g[P], q = g[Q], r = g[R];
    V spin = g[SPIN + wheel], kappa = g[KAPPA + wheel], alpha = g[ALPHA + wheel];
    V kx = c[KING_PIN_X], kz = c[KING_PIN_Z];
    V s = nx * ex + ny * ey + nz * ez;
    V cosine = root(1.0 - s * s), reciprocal = 1.0 / (cosine * (1.0 + cosine));
    V ic = reciprocal * (1.0 + cosine), lean = -2.0 * arctan(s * (reciprocal * cosine));
    V fx = (ny * ez - nz * ey) * ic, fy = (nz * ex - nx * ez) * ic, fz = (nx * ey - ny * ex) * ic;
    V lx = ey * fz - ez * fy, ly = ez * fx - ex * fz, lz = ex * fy - ey * fx;
    V rho = (g[Z] + px * ex + py * ey + pz * ez) * ic, drop = -rho * ic;
    V dx = drop * (ex - nx * s), dy = drop * (ey - ny * s), dz = drop * (ez - nz * s);
    V cx = px + dx, cy = py + dy, cz = pz + dz;
    V vcx = u + q * cz - r * cy - rate * kz * dy;
    V vcy = v + r * cx - p * cz + rate * (kz * dx - kx * dz);
    V vcz = w + p * cy - q * cx + rate * kx * dy;
    V vx = vcx * fx + vcy * fy + vcz * fz + rho * (p * nx + q * ny + r * nz);
    V vy = vcx * lx + vcy * ly + vcz * lz, vz = vcx * ex + vcy * ey + vcz * ez;
    V rolling = rho * spin;
    V load = larger(V{}, c[KZ] * (c[RADIUS] - rho) * ic - c[CZ] * vz);
    V vx2 = vx * vx, speed = root(vx2 + c[V0_SQUARED]);
    V fade = c[VL_SQUARED] / (vx2 + c[VL_SQUARED]), slip_speed = vx - rolling;
    V x0 = c[C_KAPPA] * kappa - c[DX] * fade * slip_speed;
    V y0 = (c[LS0] + c[LS1] * load) * (c[C_ALPHA] * alpha + c[C_GAMMA] * lean) - c[DY] * fade * vy;
    V limit = c[MU] * load, limit2 = limit * limit, force2 = x0 * x0 + y0 * y0;
    V grip = limit / root(root(limit2 * limit2 + force2 * force2 + 1e-12));
    V share = larger(all(-1.0), smaller(all(1.0), vx * c[INVERSE_V0])), square = share * share;
    V side = 0.125 * share * (15.0 - square * (10.0 - 3.0 * square));
    V force_x = grip * x0, force_y = grip * y0, aligning = -c[SAP] * alpha * grip * side;
    V rolling2 = rolling * rolling;
    V resistance = rho * load * (c[F1] + c[F2] * rolling2) * rolling
                   / root(rolling2 + c[V_EPS_SQUARED]);
    V axle = drive_torque - rho * force_x;
    if (wheel == 2) {
        V most = brake * c[BRAKE_TORQUE];
        axle -= larger(-most, smaller(most, axle - resistance + c[BRAKE_STIFFNESS] * spin));
    }
    g[SLOPE + SPIN + wheel] = (axle - resistance) * inverse_inertia;
    g[SLOPE + KAPPA + wheel] = -(slip_speed + speed * kappa) * c[INVERSE_SIGMA_X];
    g[SLOPE + ALPHA + wheel] = -(vy + speed * alpha) * c[INVERSE_SIGMA_Y];
    V tx = force_x * fx + force_y * lx + load * ex, ty = force_x * fy + force_y * ly + load * ey,
      tz = force_x * fz + force_y * lz + load * ez;
    V momentum = inertia * spin, gx = p + rate * kx, gy = q, gz = r + rate * kz;
    return {tx, ty, tz,
            cy * tz - cz * ty + aligning * ex - axle * nx - momentum * (gy * nz - gz * ny),
            cz * tx - cx * tz + aligning * ey - axle * ny - momentum * (gz * nx - gx * nz),
            cx * ty - cy * tx + aligning * ez - axle * nz - momentum * (gx * ny - gy * nx)};
}

static inline void evaluate(V* g, const V* c, const double* t, double mode, double demand,
                            double brake) {
    V q0 = g[Q0], q1 = g[Q1], q2 = g[Q2], q3 = g[Q3];
    V u = g[U], v = g[V_], w = g[W], p = g[P], q = g[Q], r = g[R];
    V ex = 2.0 * (q1 * q3 - q0 * q2), ey = 2.0 * (q2 * q3 + q0 * q1),
      ez = 1.0 - 2.0 * (q1 * q1 + q2 * q2);
    V spin = g[SPIN + 2] - q, torque = g[TORQUE];  // relative to the body
    V sign = mode * (demand + 1e-30 * spin) + (1.0 - mode) * (spin + 1e-30 * demand);
    V direction = sign < 0.0 ? all(-1.0) : all(1.0);
    V error = demand / c[RADIUS] - spin;
    V wanted = mode * (c[KP] * error + c[KI] * g[INTEGRATOR]) + (1.0 - mode) * demand;
    V forward = direction * spin;
    V available = smaller(c[MOTOR_TORQUE], c[MOTOR_POWER] / larger(forward, all(0.5)));
    available = smaller(available, c[MOTOR_SLOPE] * (c[NO_LOAD_SPEED] - forward));
    V granted = direction * larger(-c[REGENERATIVE], smaller(direction * wanted, available));
    g[SLOPE + TORQUE] = (granted - torque) * c[INVERSE_LAG];
    g[SLOPE + INTEGRATOR] = mode * (error - c[ANTI_WINDUP] * (wanted - granted));
    Wrench a = wheel(g, c, 0, ex, ey, ez, all(t[0]), all(t[1]), all(t[2]), all(t[3]), c[FRONT_X],
                     c[LEFT_Y], c[WHEEL_Z], c[IW_FRONT], c[INVERSE_IW_FRONT], V{}, 0.0);
    Wrench b = wheel(g, c, 1, ex, ey, ez, all(t[4]), all(t[5]), all(t[6]), all(t[7]), c[FRONT_X],
                     c[RIGHT_Y], c[WHEEL_Z], c[IW_FRONT], c[INVERSE_IW_FRONT], V{}, 0.0);
    Wrench d = wheel(g, c, 2, ex, ey, ez, V{}, all(1.0), V{}, V{}, c[REAR_X], c[REAR_Y], c[WHEEL_Z],
                     c[IW_REAR], c[INVERSE_IW_REAR], torque, brake);
    V drag = c[DRAG_PER_MASS] * u * larger(u, -u);
    V xx = 1.0 - 2.0 * (q2 * q2 + q3 * q3), xy = 2.0 * (q1 * q2 - q0 * q3),
      xz = 2.0 * (q1 * q3 + q0 * q2), yx = 2.0 * (q1 * q2 + q0 * q3),
      yy = 1.0 - 2.0 * (q1 * q1 + q3 * q3), yz = 2.0 * (q2 * q3 - q0 * q1);
    V gx = c[GRAVITY_X], gy = c[GRAVITY_Y], gz = c[GRAVITY_Z], im = c[INVERSE_MASS];
    g[SLOPE + U] = (a.fx + b.fx + d.fx) * im - gz * ex - drag - q * w + r * v - gx * xx - gy * yx;
    g[SLOPE + V_] = (a.fy + b.fy + d.fy) * im - gz * ey - r * u + p * w - gx * xy - gy * yy;
    g[SLOPE + W] = (a.fz + b.fz + d.fz) * im - gz * ez - p * v + q * u - gx * xz - gy * yz;
    g[SLOPE + P] = (a.mx + b.mx + d.mx - (c[IZZ] - c[IYY]) * q * r) * c[INVERSE_IXX];
    g[SLOPE + Q] = (a.my + b.my + d.my - (c[IXX] - c[IZZ]) * r * p) * c[INVERSE_IYY];
    g[SLOPE + R] = (a.mz + b.mz + d.mz - (c[IYY] - c[IXX]) * p * q) * c[INVERSE_IZZ];
    g[SLOPE + X] = xx * u + xy * v + xz * w;
    g[SLOPE + Y] = yx * u + yy * v + yz * w;
    g[SLOPE + Z] = ex * u + ey * v + ez * w;
    V excess = 1.0 - (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3);
    g[SLOPE + Q0] = 0.5 * (-q1 * p - q2 * q - q3 * r) + excess * q0;
    g[SLOPE + Q1] = 0.5 * (q0 * p + q2 * r - q3 * q) + excess * q1;
    g[SLOPE + Q2] = 0.5 * (q0 * q + q3 * p - q1 * r) + excess * q2;
    g[SLOPE + Q3] = 0.5 * (q0 * r + q1 * q - q2 * p) + excess * q3;
}

// Advance groups by `ticks` steps of h and record x, y and their rates, shape (4, 8 groups, ticks+1).
extern "C" void advance(double* groups, long count, long group_size, long constants,
                        const double* table, const double* drive, long ticks, double h,
                        double* out) {
    const int recorded[] = {X, Y, SLOPE + X, SLOPE + Y};
    for (long b = 0; b < count; ++b) {
        alignas(64) V g[4 * STATES];
        alignas(64) V c[BRAKE_STIFFNESS + 1];
        double* group = groups + b * group_size;
        __builtin_memcpy(g, group, sizeof g);
        __builtin_memcpy(c, group + 8 * constants, sizeof c);
        for (long k = 0;; ++k) {
            const double* command = drive + 3 * k;
            for (int stage = 0; stage < 4; ++stage) {
                const double* row = table + 8 * (2 * k + (stage + 1) / 2);
                evaluate(g, c, row, command[0], command[1], command[2]);
                if (stage == 0) {
                    for (int m = 0; m < 4; ++m)
                        for (int i = 0; i < 8; ++i)
                            out[(m * 8 * count + 8 * b + i) * (ticks + 1) + k] = g[recorded[m]][i];
                    if (k == ticks) break;
                    for (int j = 0; j < STATES; ++j) g[START + j] = g[SUM + j] = g[j];
                }
                double weight = stage == 0 || stage == 3 ? h / 6.0 : h / 3.0;
                double ahead = stage == 2 ? h : h / 2.0;
                for (int j = 0; j < STATES; ++j) {
                    g[SUM + j] += weight * g[SLOPE + j];
                    g[j] = g[START + j] + ahead * g[SLOPE + j];
                }
            }
            if (k == ticks) break;
            for (int j = 0; j < STATES; ++j) g[j] = g[SUM + j];
        }
        __builtin_memcpy(group, g, sizeof g);
    }
}
