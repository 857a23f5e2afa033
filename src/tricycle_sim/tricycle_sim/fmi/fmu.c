/* A vehicle as an FMU 2.0 for co-simulation. `vehicle.h` is generated: sizes, rows of a group of
 * vehicles, constants. The equations are in the object file that is linked with this one; a vehicle
 * is lane 0 of a group. Types and functions are those of the FMI standard 2.0.4, chapter 2. */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vehicle.h"

#define FMI __attribute__((visibility("default")))

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment environment;
} fmi2CallbackFunctions;

void vehicle_evaluate(double *group, double *table, double *drive, double *work, double *lags,
                      int64_t *none);
void vehicle_step(double *group, double *servo, double *constants, double *table, double *drive,
                  double *setpoint, double *work, double *lags, int64_t *none);
void vehicle_settle(double *group, double *servo, double *constants, double *table, double *drive,
                    double *pose, double *work, double *lags, double *steps, int64_t *none);
double vehicle_slew(double setpoint, double target, double rate);

enum { TORQUE_MODE, SLEWED, BOOLEANS };
enum { SETTING_UP, INITIALISING, STEPPING, ENDED };

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    char *name;
    int state;
    long ticks;
    double inputs[INPUTS], parameters[PARAMETERS];
    fmi2Boolean booleans[BOOLEANS];
    double time, steering, speed; /* slewed set-points */
    double heading, drive_angle, drive_speed;
    int was_speed_mode;
    double servo[SERVO_SIZE], table[3 * 8], drive[2 * 3];
    double work[16], lags[2];
    _Alignas(64) double group[GROUP];
} Vehicle;

static int64_t none;
static double steering_constants[] = STEERING_CONSTANTS;
static const int sides[] = SIDES;

static fmi2Status fail(Vehicle *v, const char *message) {
    if (v->callbacks && v->callbacks->logger)
        v->callbacks->logger(v->callbacks->environment, v->name, fmi2Error, "logStatusError",
                             "%s", message);
    return fmi2Error;
}

static double at(const Vehicle *v, int row) { return v->group[row * LANES]; }

static double wheel_speed(const Vehicle *v, int wheel) {
    double spin = at(v, ROW_SPIN + wheel * WHEEL_STATES);
    if (sides[wheel] < 0) return spin - at(v, ROW_Q);
    const double *axle = v->table + 2 * 8 + 4 * sides[wheel];
    return spin - (at(v, ROW_P) * axle[0] + at(v, ROW_Q) * axle[1] + at(v, ROW_R) * axle[2]);
}

static void read_out(Vehicle *v, int first) {
    double q0 = at(v, ROW_Q0), q1 = at(v, ROW_Q0 + 1), q2 = at(v, ROW_Q0 + 2), q3 = at(v, ROW_Q0 + 3);
    double yaw = atan2(2.0 * (q0 * q3 + q1 * q2), 1.0 - 2.0 * (q2 * q2 + q3 * q3));
    double speed = 0.0;
    double before = first ? v->parameters[START_HEADING] : v->heading;
    v->heading = before + remainder(yaw - before, 2.0 * M_PI);
    for (int wheel = 0; wheel < WHEELS; ++wheel)
        speed += at(v, ROW_TORQUE_SHARE + wheel * WHEEL_ROWS) * wheel_speed(v, wheel);
    if (!first) v->drive_angle += 0.5 * TICK * (v->drive_speed + speed);
    v->drive_speed = speed;
}

static fmi2Status start(Vehicle *v) {
    double pose[3], steps[3], standing[PARAMETERS];
    memset(v->group, 0, sizeof v->group);
    memset(v->servo, 0, sizeof v->servo);
    memset(v->drive, 0, sizeof v->drive);
    memset(v->lags, 0, sizeof v->lags);
    memcpy(standing, v->parameters, sizeof standing);
    set_aside(standing);
    vehicle_constants(standing, v->group);
    for (int i = 0; i < LANES; ++i) v->group[ROW_ALIVE * LANES + i] = 1.0;
    pose[0] = first_height(v->parameters), pose[1] = pose[2] = 0.0;
    vehicle_settle(v->group, v->servo, steering_constants, v->table, v->drive, pose, v->work, v->lags,
                   steps, &none);
    if (!(isfinite(pose[0]) && isfinite(pose[1]) && isfinite(pose[2])))
        return fail(v, "the vehicle does not stand on its wheels with these parameters");
    memset(v->group, 0, sizeof v->group);
    vehicle_constants(v->parameters, v->group);
    double heading = v->parameters[START_HEADING];
    double cr = cos(0.5 * pose[1]), sr = sin(0.5 * pose[1]), cp = cos(0.5 * pose[2]);
    double sp = sin(0.5 * pose[2]), cy = cos(0.5 * heading), sy = sin(0.5 * heading);
    double q0 = cr * cp, q1 = sr * cp, q2 = cr * sp, q3 = -sr * sp;
    for (int i = 0; i < LANES; ++i) {
        double *g = v->group + i;
        g[ROW_X * LANES] = v->parameters[START_X];
        g[ROW_Y * LANES] = v->parameters[START_Y];
        g[ROW_Z * LANES] = pose[0];
        g[ROW_Q0 * LANES] = cy * q0 - sy * q3;
        g[(ROW_Q0 + 1) * LANES] = cy * q1 - sy * q2;
        g[(ROW_Q0 + 2) * LANES] = cy * q2 + sy * q1;
        g[(ROW_Q0 + 3) * LANES] = cy * q3 + sy * q0;
        g[ROW_U * LANES] = v->parameters[START_SPEED];
        g[ROW_ALIVE * LANES] = 1.0;
        for (int wheel = 0; wheel < WHEELS; ++wheel) {
            g[(ROW_SPIN + wheel * WHEEL_STATES) * LANES] =
                v->parameters[START_SPEED] / wheel_radius(v->parameters, wheel);
            g[(ROW_LEAST_LOAD + wheel * EVENT_ROWS) * LANES] = INFINITY;
        }
    }
    memcpy(v->table + 2 * 8, v->table, 8 * sizeof(double));
    v->steering = 0.0;
    v->speed = v->parameters[START_SPEED_SETPOINT];
    v->was_speed_mode = 1;
    v->ticks = 0;
    v->drive_angle = 0.0;
    vehicle_evaluate(v->group, v->table, v->drive, v->work, v->lags, &none);
    read_out(v, 1);
    return fmi2OK;
}

static fmi2Status tick(Vehicle *v) {
    int speed_mode = !v->booleans[TORQUE_MODE], slewed = v->booleans[SLEWED];
    double steering = v->inputs[STEERING_SETPOINT], speed = v->inputs[SPEED_SETPOINT];
    v->steering = slewed ? steering : vehicle_slew(v->steering, steering, STEERING_SLEW);
    if (speed_mode)
        v->speed = slewed ? speed : vehicle_slew(v->speed, speed, ACCELERATION);
    else /* the set-point goes on from the speed there is */
        v->speed = v->drive_speed * wheel_radius(v->parameters, DRIVEN);
    if (speed_mode && !v->was_speed_mode) /* the controller starts anew */
        for (int i = 0; i < LANES; ++i) v->group[ROW_INTEGRATOR * LANES + i] = 0.0;
    v->was_speed_mode = speed_mode;
    for (int row = 0; row < 2; ++row) {
        v->drive[3 * row] = speed_mode;
        v->drive[3 * row + 1] = speed_mode ? v->speed : v->inputs[TORQUE_SETPOINT];
        v->drive[3 * row + 2] = v->inputs[BRAKE];
    }
    vehicle_step(v->group, v->servo, steering_constants, v->table, v->drive, &v->steering, v->work,
                 v->lags, &none);
    v->ticks += 1;
    read_out(v, 0);
    if (!isfinite(at(v, ROW_X) + at(v, ROW_Y) + v->heading + v->drive_speed))
        return fail(v, "the vehicle's state is not finite");
    return fmi2OK;
}

static double output(const Vehicle *v, unsigned number) {
    double q0 = at(v, ROW_Q0), q1 = at(v, ROW_Q0 + 1), q2 = at(v, ROW_Q0 + 2), q3 = at(v, ROW_Q0 + 3);
    double u = at(v, ROW_U), s = at(v, ROW_U + 1), w = at(v, ROW_U + 2);
    double gx = at(v, ROW_GRAVITY_X), gy = at(v, ROW_GRAVITY_Y), gz = at(v, ROW_GRAVITY_Z);
    switch (number) {
    case 0: return at(v, ROW_X);
    case 1: return at(v, ROW_Y);
    case 2: return at(v, ROW_Z);
    case 3: return v->heading;
    case 4: return atan2(2.0 * (q0 * q1 + q2 * q3), 1.0 - 2.0 * (q1 * q1 + q2 * q2));
    case 5: return asin(fmax(-1.0, fmin(1.0, 2.0 * (q0 * q2 - q3 * q1))));
    case 6: return u;
    case 7: return s;
    case 8: return at(v, ROW_R);
    case 9:
        return at(v, ROW_SLOPE_U) + at(v, ROW_Q) * w - at(v, ROW_R) * s
            + gz * 2.0 * (q1 * q3 - q0 * q2) + gx * (1.0 - 2.0 * (q2 * q2 + q3 * q3))
            + gy * 2.0 * (q1 * q2 + q0 * q3);
    case 10:
        return at(v, ROW_SLOPE_U + 1) + at(v, ROW_R) * u - at(v, ROW_P) * w
            + gz * 2.0 * (q2 * q3 + q0 * q1) + gx * 2.0 * (q1 * q2 - q0 * q3)
            + gy * (1.0 - 2.0 * (q1 * q1 + q3 * q3));
    case 11: return v->servo[0];
    case 12: return v->servo[1];
    case 13: return v->drive_speed;
    case 14: return v->drive_angle;
    case 15: return at(v, ROW_TORQUE);
    default:
        number -= 16;
        return number < WHEELS ? wheel_speed(v, (int)number)
                               : at(v, ROW_LOAD + ((int)number - WHEELS) * WHEEL_EVALUATED);
    }
}

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String s[]) {
    (void)c, (void)on, (void)n, (void)s;
    return fmi2OK;
}

FMI fmi2Status fmi2Reset(fmi2Component c) {
    static const double starts[] = PARAMETER_STARTS;
    Vehicle *v = c;
    memset(v->inputs, 0, sizeof v->inputs);
    memcpy(v->parameters, starts, sizeof starts);
    memset(v->booleans, 0, sizeof v->booleans);
    v->state = SETTING_UP;
    return start(v);
}

FMI fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                                  const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                  fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    if (type != 1 || !guid || strcmp(guid, GUID)) {
        if (callbacks && callbacks->logger)
            callbacks->logger(callbacks->environment, name, fmi2Error, "logStatusError",
                              "needs co-simulation and the GUID of this modelDescription.xml");
        return NULL;
    }
    Vehicle *v = aligned_alloc(64, (sizeof(Vehicle) + 63) / 64 * 64);
    if (!v) return NULL;
    memset(v, 0, sizeof *v);
    v->callbacks = callbacks;
    v->name = strdup(name ? name : "");
    if (!v->name || fmi2Reset(v) != fmi2OK) {
        free(v->name);
        free(v);
        return NULL;
    }
    return v;
}

FMI void fmi2FreeInstance(fmi2Component c) {
    if (!c) return;
    free(((Vehicle *)c)->name);
    free(c);
}

FMI fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                   fmi2Real start_time, fmi2Boolean has_stop, fmi2Real stop_time) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((Vehicle *)c)->time = start_time;
    return fmi2OK;
}

FMI fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    ((Vehicle *)c)->state = INITIALISING;
    return start(c);
}

FMI fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    fmi2Status status = start(c);
    ((Vehicle *)c)->state = STEPPING;
    return status;
}

FMI fmi2Status fmi2Terminate(fmi2Component c) {
    ((Vehicle *)c)->state = ENDED;
    return fmi2OK;
}

FMI fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real out[]) {
    Vehicle *v = c;
    for (size_t i = 0; i < n; ++i) {
        if (r[i] < INPUTS) out[i] = v->inputs[r[i]];
        else if (r[i] >= FIRST_OUTPUT && r[i] < FIRST_OUTPUT + OUTPUTS)
            out[i] = output(v, r[i] - FIRST_OUTPUT);
        else if (r[i] >= FIRST_PARAMETER && r[i] < FIRST_PARAMETER + PARAMETERS)
            out[i] = v->parameters[r[i] - FIRST_PARAMETER];
        else return fail(v, "fmi2GetReal: no such variable");
    }
    return fmi2OK;
}

FMI fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
                           const fmi2Real in[]) {
    Vehicle *v = c;
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(in[i])) return fail(v, "fmi2SetReal: a value is not finite");
        if (r[i] < INPUTS) v->inputs[r[i]] = in[i];
        else if (r[i] >= FIRST_PARAMETER && r[i] < FIRST_PARAMETER + PARAMETERS) {
            if (v->state >= STEPPING) return fail(v, "fmi2SetReal: parameters are fixed by now");
            v->parameters[r[i] - FIRST_PARAMETER] = in[i];
        } else return fail(v, "fmi2SetReal: no such input or parameter");
    }
    return fmi2OK;
}

FMI fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n,
                              fmi2Boolean out[]) {
    for (size_t i = 0; i < n; ++i) {
        if (r[i] >= BOOLEANS) return fail(c, "fmi2GetBoolean: no such variable");
        out[i] = ((Vehicle *)c)->booleans[r[i]];
    }
    return fmi2OK;
}

FMI fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n,
                              const fmi2Boolean in[]) {
    for (size_t i = 0; i < n; ++i) {
        if (r[i] >= BOOLEANS) return fail(c, "fmi2SetBoolean: no such variable");
        if (r[i] == SLEWED && ((Vehicle *)c)->state >= STEPPING)
            return fail(c, "fmi2SetBoolean: parameters are fixed by now");
        ((Vehicle *)c)->booleans[r[i]] = in[i] != 0;
    }
    return fmi2OK;
}

#define NO_VARIABLES(name, type)                                                                   \
    FMI fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, type values[]) {  \
        (void)r, (void)values;                                                                     \
        return n ? fail(c, #name ": there are none of this type") : fmi2OK;                        \
    }
NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetString, const fmi2String)

FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean final) {
    (void)time, (void)final;
    Vehicle *v = c;
    if (v->state != STEPPING) return fail(v, "fmi2DoStep: is not initialised, or has ended");
    double ticks = round(step / TICK);
    if (ticks < 1.0 || fabs(step - ticks * TICK) > 1e-6 * TICK)
        return fail(v, "fmi2DoStep: needs steps of a multiple of 0.01 s");
    for (long left = (long)ticks; left > 0; --left)
        if (tick(v) != fmi2OK) return fmi2Error;
    return fmi2OK;
}

FMI fmi2Status fmi2CancelStep(fmi2Component c) { return fail(c, "fmi2CancelStep: is not offered"); }

#define NOT_OFFERED(name, ...)                                                                     \
    FMI fmi2Status name(fmi2Component c, __VA_ARGS__) { return fail(c, #name ": is not offered"); }
NOT_OFFERED(fmi2GetFMUstate, fmi2FMUstate *s)
NOT_OFFERED(fmi2SetFMUstate, fmi2FMUstate s)
NOT_OFFERED(fmi2FreeFMUstate, fmi2FMUstate *s)
NOT_OFFERED(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
NOT_OFFERED(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
NOT_OFFERED(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
NOT_OFFERED(fmi2GetDirectionalDerivative, const fmi2ValueReference u[], size_t n,
            const fmi2ValueReference k[], size_t m, const fmi2Real d[], fmi2Real out[])
NOT_OFFERED(fmi2SetRealInputDerivatives, const fmi2ValueReference r[], size_t n,
            const fmi2Integer order[], const fmi2Real d[])
NOT_OFFERED(fmi2GetRealOutputDerivatives, const fmi2ValueReference r[], size_t n,
            const fmi2Integer order[], fmi2Real d[])
NOT_OFFERED(fmi2GetRealStatus, int kind, fmi2Real *out)
NOT_OFFERED(fmi2GetIntegerStatus, int kind, fmi2Integer *out)
NOT_OFFERED(fmi2GetBooleanStatus, int kind, fmi2Boolean *out)
NOT_OFFERED(fmi2GetStringStatus, int kind, fmi2String *out)
NOT_OFFERED(fmi2GetStatus, int kind, fmi2Status *out)
