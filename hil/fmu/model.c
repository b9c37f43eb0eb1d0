/* The plant around the translated kernel: commands with their delay, the move, and the view, as hil/plant/plant.py. */

static double least(double a, double b) { return b < a ? b : a; }
static double most(double a, double b) { return b > a ? b : a; }

typedef struct {
    double value[VARIABLES]; /* by value reference */
    Parameters p;
    State x;
    View seen;
    Inputs inputs;
    double nodes[NODES][4], pulls[NODES][2];
    long long t_ns, grid_ns, due_ns[WAITING];
    double waiting[WAITING], command, latest, rail_start, pulley_start;
    int first, count, braked;
} Model;

static void look(Model *m)
{
    observe(&m->p, &m->x, m->nodes, m->pulls, &m->inputs, &m->seen, m->grid_ns * 1e-9, (m->t_ns - m->grid_ns) * 1e-9,
            m->braked);
}

/* One move from rest to rest, as hil.plant.moves.leg; returns when it ends. */
static double leg(double (*rows)[5], double start, double origin, double target, double speed, double acceleration)
{
    double way = fabs(target - origin), sign = copysign(1.0, target - origin);
    double top = least(speed, sqrt(way * acceleration)), ramp_s = top / acceleration;
    double cruise_s = most(0.0, way / top - ramp_s), bend = 0.5 * sign * acceleration;
    double ramp = bend * ramp_s * ramp_s, end = start + 2.0 * ramp_s + cruise_s;
    double found[4][5] = {{start, origin, 0.0, bend, 0.0},
                          {start + ramp_s, origin + ramp, sign * top, 0.0, 0.0},
                          {start + ramp_s + cruise_s, target - ramp, sign * top, -bend, 0.0},
                          {end, target, 0.0, 0.0, 0.0}};
    memcpy(rows, found, sizeof found);
    return end;
}

/* Segments: of the mechanism's move, and one for each force and the mass, whose value is an input. */
static void prescribe(Model *m)
{
    int row = 0, channel;
    double angle = m->value[MOVE_ANGLE], turn;
    memset(&m->inputs, 0, sizeof m->inputs);
    if (angle != 0.0) {
        turn = leg(m->inputs.segments, m->value[MOVE_START], 0.0, angle, m->value[MOVE_SPEED], m->value[MOVE_ACCELERATION]);
        leg(m->inputs.segments + 3, turn, angle, 0.0, m->value[MOVE_SPEED], m->value[MOVE_ACCELERATION]);
        row = 7;
    }
    m->inputs.spans[MECHANISM][1] = row;
    for (channel = FORCE_TANGENTIAL; channel <= MASS; channel++) {
        m->inputs.spans[channel][0] = m->inputs.cursor[channel] = row;
        m->inputs.spans[channel][1] = ++row;
    }
}

static void take_inputs(Model *m)
{
    int channel;
    double command = m->value[COMMAND];
    for (channel = FORCE_TANGENTIAL; channel <= MASS; channel++)
        m->inputs.segments[m->inputs.spans[channel][0]][1] = m->value[FIRST_FORCE + channel - FORCE_TANGENTIAL];
    m->braked = m->value[BRAKED] != 0.0;
    if (command != m->latest && m->count < WAITING) {
        int place = (m->first + m->count++) % WAITING;
        m->due_ns[place] = m->t_ns + llround(m->value[COMMAND_DELAY] * 1e9);
        m->waiting[place] = m->latest = command;
    }
}

static void show(Model *m)
{
    look(m);
    m->value[OUT_TENSION] = m->seen.tension;
    m->value[OUT_VERTICAL] = m->seen.vertical;
    m->value[OUT_TANGENTIAL] = m->seen.tangential;
    m->value[OUT_NORMAL] = m->seen.normal;
    m->value[OUT_STROKE] = m->seen.stroke;
    m->value[OUT_SPEED] = m->seen.speed;
    m->value[OUT_MECHANISM] = m->seen.mechanism;
    m->value[OUT_RAIL] = m->seen.rail - m->rail_start;
    m->value[OUT_PULLEY] = m->seen.pulley - m->pulley_start;
    m->value[OUT_HEIGHT] = m->seen.height;
    m->value[TIME] = m->t_ns * 1e-9;
}

static void preload(Model *m, double tension)
{
    int turn;
    if (m->p.vertical_free != 0.0)
        m->x.uz = (tension - 0.5 * m->p.rope_mass * GRAVITY) / m->p.vertical_stiffness;
    look(m);
    m->x.play = 0.0;
    m->x.motor += tension / m->p.stiffness - m->seen.stretch;
    for (turn = 0; turn < 4; turn++) {
        m->x.stroke = m->x.motor + screw_error(&m->p, m->x.motor);
        look(m);
        m->x.motor += tension / m->p.stiffness - m->seen.stretch;
    }
    m->x.motor_before = m->x.motor;
    m->x.tension = tension;
}

/* As Plant._hang: rope plumb and slack, pulley out along the rail where friction holds it, then the preload. */
static void initialise(Model *m)
{
    int i, elements = ELEMENTS;
    double dx, dy, upper_x, upper_y, share;
    memset(&m->x, 0, sizeof m->x);
    memset(m->nodes, 0, sizeof m->nodes);
    m->t_ns = m->grid_ns = llround(m->value[TIME] * 1e9);
    m->first = m->count = 0;
    m->command = m->latest = 0.0;
    set_parameters(&m->p, m->value);
    m->p.elements = elements;
    m->p.lag_decay = exp(-STEP_NS * 1e-9 / m->p.lag);
    prescribe(m);
    m->braked = 1;
    take_inputs(m);
    dx = m->p.radius - m->p.eccentricity_x;
    dy = -m->p.eccentricity_y;
    m->x.phi = atan2(dy, dx);
    m->x.r = hypot(dx, dy) + m->value[REST_SHARE] * m->p.pulley_static * m->p.rope_length;
    upper_x = m->p.eccentricity_x + m->x.r * cos(m->x.phi);
    upper_y = m->p.eccentricity_y + m->x.r * sin(m->x.phi);
    for (i = 0; i < elements - 1; i++) {
        share = (double)(i + 1) / elements;
        m->nodes[i][0] = upper_x + share * (m->p.radius - upper_x);
        m->nodes[i][1] = upper_y * (1.0 - share);
    }
    m->rail_start = m->x.phi;
    m->pulley_start = m->x.r;
    if (m->value[PRELOAD] > 0.0)
        preload(m, m->value[PRELOAD]);
    show(m);
}

static void advance(Model *m, long long t_ns)
{
    int used = in_use(&m->inputs);
    take_inputs(m);
    while (m->grid_ns + STEP_NS <= t_ns) {
        /* a command counts from the step whose middle it precedes */
        while (m->count && m->due_ns[m->first] <= m->grid_ns + STEP_NS / 2) {
            m->command = m->waiting[m->first];
            m->first = (m->first + 1) % WAITING;
            m->count--;
        }
        step(&m->p, &m->x, m->nodes, m->pulls, &m->inputs, used, m->grid_ns * 1e-9, STEP_NS * 1e-9, m->command, m->braked);
        m->grid_ns += STEP_NS;
    }
    m->t_ns = t_ns;
    show(m);
}
