/* A direct controller on zenoh-pico, written from docs/wire.md: the paper's rule for one inverter.

       controller PLAN.JSON NODE [RECORDER PLANT PARENT]

   Endpoints such as tcp/10.0.0.2:7500 take the place of the plan's ports on 127.0.0.1. Each link has a
   session of its own, so that it comes and goes by itself. Zenoh's threads decode messages and queue
   them; the main thread decides and publishes. It has no TLS: with keys, a gateway at these endpoints has. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <zenoh-pico.h>
#include <zenoh-pico/transport/common/tx.h>

#include "msgpack.h"

enum { RECORDER, PLANT, PARENT, LINKS };
enum { TELEMETRY, DISPATCH, SETPOINT, RUN, INPUTS };
enum { IMPP, RESIDUAL, HELP, COMMAND, OUTPUTS };
enum { CYCLE, INCARNATION, PUBLISHED, POWER, ALPHA, RATING, AVAILABLE, FIELDS };
enum { IDLE, ESTIMATE, ACTUATE };
enum { PROTOCOL = 4, LONGEST = 4096, MOST_WAITING = 64, KEY = 1024 };
static const char *const HEARD[] = {"telemetry", "dispatch", "setpoint", "run"};
static const char *const SAID[] = {"impp", "residual", "help", "command"};
static const char *const NAMES[] = {"cycle", "incarnation",     "publish_time_ns", "power_kw",
                                    "alpha", "plant_rating_kw", "available_kw"};
static const int64_t BEFORE_ALL = -(INT64_C(1) << 31), LOOK_NS = 100000000;
static const double ROUNDING = 1e-9, METER_TOLERANCE = 0.05;
static const double EARLIER = 0.98; /* It closes a stage by so much of its time: its cycle begins with a message. */

typedef struct {
    int signal;
    bool stops;
    int64_t came_ns, integer[FIELDS];
    double number[FIELDS];
} message;

static struct { /* What the controller needs of the plan. */
    char prefix[512], node[256], parent[256], endpoints[LINKS][256];
    int64_t start_ns, cycle_ns, cycle_wall_ns, cycles, hold, parent_period;
    double deadline_ns[ACTUATE + 1]; /* By when each stage closes, after the tick. */
    double rating_kw, alpha_min;
} plan;

static struct {
    z_owned_session_t session;
    z_owned_liveliness_token_t token;
    bool is_open;
} links[LINKS];

static struct { /* Between Zenoh's threads and the main one. */
    z_owned_mutex_t lock;
    z_owned_condvar_t wake;
    message waiting[MOST_WAITING];
    size_t first, count;
} queue;

static struct {
    int stage;
    int64_t cycle, incarnation, entered_ns, ready_ns, clock_ns, measured_cycle, stale_cycles;
    int64_t heard[INPUTS], process[INPUTS], sequence[OUTPUTS];
    message newest[INPUTS];
    double impp_kw;
} self;

static int64_t now_ns(void) {
    z_clock_t now = z_clock_now();
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* What comes in, on Zenoh's threads -------------------------------------------------------------- */

static bool is(mp_item item, const char *text) {
    return item.kind == MP_TEXT && item.size == strlen(text) && !memcmp(item.text, text, item.size);
}

static bool decode(mp_reader in, message *found) {
    static const int needed[] = {1 << POWER | 1 << ALPHA, 1 << POWER | 1 << RATING, 1 << POWER, 0};
    int seen = 0, missing = needed[found->signal] | 1 << CYCLE;
    bool is_from_publisher = false, has_state = found->signal != RUN;
    mp_item map = mp_read(&in);
    for (uint64_t entry = 0; entry < map.size; entry++) {
        mp_item key = mp_read(&in), value = mp_read(&in);
        if (map.kind != MP_MAP || key.kind != MP_TEXT || !mp_skip(&in, value)) return false;
        for (int field = 0; field < FIELDS; field++) {
            if (!is(key, NAMES[field]) || value.kind == MP_NIL) continue;
            if (value.kind != MP_INTEGER && (value.kind != MP_NUMBER || field < POWER)) return false;
            found->integer[field] = value.integer;
            found->number[field] = value.number;
            seen |= 1 << field;
        }
        if (is(key, "source")) is_from_publisher = is(value, found->signal == SETPOINT ? plan.parent : "plant");
        if (is(key, "state")) has_state = true, found->stops = is(value, "stop");
    }
    if (!(seen & 1 << AVAILABLE)) found->number[AVAILABLE] = NAN;
    return in.at == in.end && is_from_publisher && has_state && !(missing & ~seen);
}

static void hear(z_loaned_sample_t *sample, void *signal) {
    uint8_t bytes[LONGEST];
    message found = {.signal = (int)(intptr_t)signal, .came_ns = now_ns()};
    z_bytes_reader_t payload = z_bytes_get_reader(z_sample_payload(sample));
    size_t size = z_bytes_reader_read(&payload, bytes, sizeof bytes);
    if (z_bytes_reader_remaining(&payload) || !decode((mp_reader){bytes, bytes + size}, &found)) return;
    z_mutex_lock(z_loan_mut(queue.lock));
    if (queue.count < MOST_WAITING) queue.waiting[(queue.first + queue.count++) % MOST_WAITING] = found;
    z_condvar_signal(z_loan_mut(queue.wake));
    z_mutex_unlock(z_loan_mut(queue.lock));
}

static bool take(message *found, int64_t until_ns) {
    z_clock_t until = {.tv_sec = until_ns / 1000000000, .tv_nsec = until_ns % 1000000000};
    z_mutex_lock(z_loan_mut(queue.lock));
    while (!queue.count && now_ns() < until_ns)
        z_condvar_wait_until(z_loan_mut(queue.wake), z_loan_mut(queue.lock), &until);
    bool any = queue.count > 0;
    if (any) *found = queue.waiting[queue.first], queue.first = (queue.first + 1) % MOST_WAITING, queue.count--;
    z_mutex_unlock(z_loan_mut(queue.lock));
    return any;
}

/* Links ------------------------------------------------------------------------------------------ */

static z_view_keyexpr_t key_of(char *text, const char *node, const char *signal) {
    z_view_keyexpr_t key;
    snprintf(text, KEY, "%s%s/%s", plan.prefix, node, signal);
    z_view_keyexpr_from_str(&key, text);
    return key;
}

static void subscribe(int to, int signal, const char *node) {
    char text[KEY];
    z_view_keyexpr_t key = key_of(text, node, HEARD[signal]);
    z_owned_closure_sample_t callback;
    z_closure(&callback, hear, NULL, (void *)(intptr_t)signal);
    z_declare_background_subscriber(z_loan(links[to].session), z_loan(key), z_move(callback), NULL);
}

static bool open_link(int to) {
    char text[KEY];
    z_owned_config_t config;
    _z_network_message_t end;
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, Z_CONFIG_MODE_PEER);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, plan.endpoints[to]);
    if (z_open(&links[to].session, z_move(config), NULL) < 0) return false;
    const z_loaned_session_t *session = z_loan(links[to].session);
    if (to == PARENT) subscribe(to, SETPOINT, plan.node);
    if (to == PLANT) subscribe(to, TELEMETRY, plan.node), subscribe(to, DISPATCH, ""), subscribe(to, RUN, "");
    z_view_keyexpr_t alive = key_of(text, plan.node, "alive");
    z_liveliness_declare_token(session, &links[to].token, z_loan(alive), NULL);
    /* These were all declarations: before it knows, the other side sends all that it publishes. */
    _z_n_msg_make_declare(&end, _z_make_decl_final(), _z_optional_id_make_some(0));
    _z_send_n_msg(_Z_RC_IN_VAL(session), &end, Z_RELIABILITY_RELIABLE, Z_CONGESTION_CONTROL_BLOCK, NULL);
    _z_n_msg_clear(&end);
    return true;
}

static void count_peer(const z_id_t *id, void *count) { (void)id, ++*(int *)count; }

/* Open what is not open. A run whose link to the plant closes without a stop is over: forget it. */
static void look_after_links(void) {
    for (int to = 0; to < LINKS; to++) {
        int peers = 0;
        z_owned_closure_zid_t callback;
        z_closure(&callback, count_peer, NULL, &peers);
        if (links[to].is_open) z_info_peers_zid(z_loan(links[to].session), z_move(callback));
        if (links[to].is_open && !peers) {
            z_drop(z_move(links[to].token)), z_drop(z_move(links[to].session));
            links[to].is_open = false;
            if (to == PLANT) self.cycle = BEFORE_ALL, self.stage = IDLE;
        }
        if (!links[to].is_open && *plan.endpoints[to]) links[to].is_open = open_link(to);
    }
}

/* What goes out ---------------------------------------------------------------------------------- */

static mp_writer begin(int signal, int own_fields) {
    mp_writer out = {.size = 0};
    mp_put(&out, (uint8_t)(0x80 | (8 + own_fields)), 0, 0);
    mp_integer(&out, "cycle", self.cycle);
    mp_integer(&out, "sim_time_ns", plan.start_ns + self.cycle * plan.cycle_ns);
    mp_text(&out, "source"), mp_text(&out, plan.node + 1);
    mp_text(&out, "missing"), mp_put(&out, 0x90, 0, 0);
    mp_integer(&out, "ready_time_ns", self.ready_ns + self.clock_ns);
    mp_integer(&out, "publish_time_ns", now_ns() + self.clock_ns);
    mp_integer(&out, "sequence", self.cycle < 0 ? 0 : self.sequence[signal]++);
    mp_integer(&out, "incarnation", self.incarnation);
    return out;
}

static void put(const mp_writer *out, int signal, int to) {
    char text[KEY];
    z_view_keyexpr_t key = key_of(text, plan.node, SAID[signal]);
    z_owned_bytes_t payload;
    z_owned_encoding_t encoding;
    z_put_options_t options;
    if (!links[to].is_open) return;
    z_bytes_copy_from_buf(&payload, out->bytes, out->size);
    z_encoding_from_str(&encoding, "application/msgpack");
    z_put_options_default(&options);
    options.encoding = z_move(encoding);
    options.congestion_control = Z_CONGESTION_CONTROL_BLOCK;
    z_put(z_loan(links[to].session), z_loan(key), z_move(payload), &options);
}

/* The cycle -------------------------------------------------------------------------------------- */

static const message *input(int signal) { /* The newest message; NULL if it has expired. */
    int64_t due = self.cycle - (signal == SETPOINT ? plan.parent_period - 1 : 0);
    return due - self.newest[signal].integer[CYCLE] <= plan.hold ? &self.newest[signal] : NULL;
}

static double share_kw(void) { /* The inverter's share of the dispatch (eq. 3); NAN if that has expired. */
    const message *dispatch = input(DISPATCH);
    if (!dispatch) return NAN;
    double plant_kw = dispatch->number[RATING];
    return fmin(fmax(dispatch->number[POWER], 0.0), plant_kw) * (plan.rating_kw / plant_kw);
}

static void measure(void) { /* Its maximum (eq. 1); without a new usable measurement the last one. */
    const message *new = input(TELEMETRY);
    double most_kw = plan.rating_kw * (1.0 + METER_TOLERANCE);
    self.stale_cycles++;
    if (!new || (self.cycle >= 0 && new->integer[CYCLE] <= self.measured_cycle)) return;
    self.measured_cycle = new->integer[CYCLE];
    double power_kw = new->number[POWER], alpha = new->number[ALPHA], available_kw = new->number[AVAILABLE];
    double least_kw = -METER_TOLERANCE * plan.rating_kw;
    if (!(power_kw >= least_kw && power_kw <= most_kw && alpha > 0.0 && alpha <= 1.0)) return; /* Or NAN. */
    bool is_stated = alpha < 1.0 && available_kw >= 0.0 && available_kw <= most_kw;
    self.impp_kw = fmin(is_stated ? available_kw : fmax(power_kw, 0.0) / alpha, plan.rating_kw);
    self.stale_cycles = 0;
}

static bool is_lost(void) { /* The plant is heard, but for too long nothing usable of the inverter. */
    return input(DISPATCH) && self.stale_cycles > plan.hold;
}

static void estimate(void) {
    measure();
    double impp_kw = is_lost() ? 0.0 : self.impp_kw;
    double wanted_kw = share_kw(), residual_kw = impp_kw - (isnan(wanted_kw) ? 0.0 : wanted_kw);
    mp_writer impp = begin(IMPP, 2), residual = begin(RESIDUAL, 1);
    mp_number(&impp, "power_kw", impp_kw);
    mp_integer(&impp, "stale_cycles", self.stale_cycles);
    mp_number(&residual, "power_kw", residual_kw);
    put(&impp, IMPP, PARENT), put(&residual, RESIDUAL, PARENT);
    put(&impp, IMPP, RECORDER), put(&residual, RESIDUAL, RECORDER);
    if (!(residual_kw < 0.0)) return;
    mp_writer help = begin(HELP, 1);
    mp_number(&help, "missing_kw", -residual_kw);
    put(&help, HELP, RECORDER);
}

/* Command the setpoint (eq. 6), else the own share; without either, and before the first
   telemetry, the inverter decides. */
static void actuate(void) {
    const message *setpoint = input(SETPOINT);
    bool lost = is_lost();
    double wanted_kw = share_kw(), alpha = 1.0;
    double target_kw = setpoint && !lost ? setpoint->number[POWER] : wanted_kw;
    if (isnan(target_kw) || self.measured_cycle == BEFORE_ALL) return;
    if (target_kw < self.impp_kw * (1.0 - ROUNDING))
        alpha = fmin(fmax(target_kw / self.impp_kw, plan.alpha_min), 1.0);
    bool reverts = !isnan(wanted_kw);
    mp_writer command = begin(COMMAND, reverts ? 3 : 2);
    mp_number(&command, "alpha", alpha);
    mp_number(&command, "power_kw", lost ? target_kw : alpha < 1.0 ? alpha * self.impp_kw : plan.rating_kw);
    if (reverts) mp_number(&command, "revert_kw", wanted_kw);
    put(&command, COMMAND, PLANT), put(&command, COMMAND, RECORDER);
}

/* Close the open stage if its inputs are there or its time is up; then the next one. */
static void advance(bool time_is_up) {
    bool has_both = self.heard[TELEMETRY] == self.cycle && self.heard[DISPATCH] == self.cycle;
    bool parent_acts = self.cycle < 0 || self.cycle % plan.parent_period == 0;
    self.ready_ns = now_ns();
    if (self.stage == ESTIMATE && (time_is_up || has_both)) {
        self.stage = ACTUATE, time_is_up = false;
        estimate();
    }
    if (self.stage == ACTUATE && (time_is_up || !parent_acts || self.heard[SETPOINT] == self.cycle)) {
        self.stage = IDLE;
        actuate();
    }
}

static void enter(int64_t cycle) { /* A round, cycle 0 and a run under way begin with nothing known. */
    if (cycle < 0 || self.cycle < 0) {
        int64_t clock_ns = self.clock_ns;
        memset(&self, 0, sizeof self);
        self.clock_ns = clock_ns, self.measured_cycle = BEFORE_ALL, self.incarnation = cycle > 0 ? cycle : 0;
        for (int signal = 0; signal < INPUTS; signal++)
            self.heard[signal] = self.newest[signal].integer[CYCLE] = BEFORE_ALL;
    }
    self.cycle = cycle, self.stage = ESTIMATE, self.entered_ns = now_ns();
}

static void take_in(const message *new) {
    int signal = new->signal;
    int64_t cycle = new->integer[CYCLE];
    double power_kw = new->number[POWER], plant_kw = new->number[RATING];
    if (new->integer[PUBLISHED] > 0) self.clock_ns = new->integer[PUBLISHED] - new->came_ns;
    /* Only the plant begins a cycle, and none beyond the run. */
    if (cycle >= plan.cycles || (cycle > self.cycle && signal == SETPOINT)) return;
    if (signal == SETPOINT && cycle >= 0 && cycle % plan.parent_period) return; /* Not its turn. */
    if (cycle > self.cycle) enter(cycle);
    if (new->integer[INCARNATION] < self.process[signal]) return; /* Of a process that was replaced. */
    if (cycle <= self.heard[signal]) return; /* It comes again, or after a newer one. */
    self.heard[signal] = cycle;
    bool is_usable = signal != SETPOINT || (power_kw >= 0.0 && power_kw <= plan.rating_kw * (1.0 + ROUNDING));
    if (signal == DISPATCH) is_usable = isfinite(power_kw) && plant_kw > 0.0 && isfinite(plant_kw);
    if (is_usable) self.newest[signal] = *new, self.process[signal] = new->integer[INCARNATION];
    advance(false);
}

/* The plan: each name is looked for as it stands there, without a reader of JSON ------------------- */

static const char *value_of(const char *json, const char *name) {
    char quoted[KEY];
    snprintf(quoted, sizeof quoted, "\"%s\"", name);
    const char *found = strstr(json, quoted);
    if (!found) return "";
    found += strlen(quoted) + strspn(found + strlen(quoted), ":,[ \n");
    return *found == '"' ? found + 1 : found;
}

static void read_deadlines(const char *json, int level) {
    const char *at = value_of(json, "inverters");
    int tiers = 1; /* Below the central controller: one more than a path has slashes. */
    for (int closed = 0, slashes = 0; *at && closed < 2; at++) {
        closed = *at == '[' ? 0 : closed + (*at == ']');
        slashes = *at == '"' ? 0 : slashes + (*at == '/');
        if (slashes >= tiers) tiers = slashes + 1;
    }
    double part_ns = 0.9 * (double)plan.cycle_wall_ns / (3 * tiers + 2);
    plan.deadline_ns[ESTIMATE] = (tiers + 1) * part_ns, plan.deadline_ns[ACTUATE] = (2 * tiers + level + 1) * part_ns;
}

static void read_plan(const char *json, const char *node, char **endpoints) {
    int level = 1;
    const char *slash = strrchr(node, '/'), *period = value_of(json, "period_cycles"), *run, *plant, *port;
    run = value_of(json, *value_of(json, "namespace") == '"' ? "run_id" : "namespace");
    plant = value_of(json, "plant");
    snprintf(plan.prefix, sizeof plan.prefix, "%.*s/%.*s", (int)strcspn(run, "\""), run, (int)strcspn(plant, "\""), plant);
    snprintf(plan.node, sizeof plan.node, "/%s", node);
    snprintf(plan.parent, sizeof plan.parent, "%.*s", slash ? (int)(slash - node) : 7, slash ? node : "central");
    const char *names[] = {"recorder", "plant", plan.parent};
    for (int to = 0; to < LINKS; to++) {
        port = value_of(value_of(json, "tcp_ports"), names[to]);
        if (*port) snprintf(plan.endpoints[to], sizeof plan.endpoints[to], "tcp/127.0.0.1:%d", atoi(port));
        if (*endpoints) snprintf(plan.endpoints[to], sizeof plan.endpoints[to], "%s", *endpoints++);
    }
    plan.rating_kw = atof(value_of(json, node)), plan.alpha_min = atof(value_of(json, "alpha_min"));
    bool forecasts = !strncmp(value_of(json, "scheme"), "predictive", 10);
    if (forecasts && !strncmp(value_of(json, "actuator"), "limit", 5)) plan.alpha_min = 0.001;
    plan.start_ns = atoll(value_of(json, "start_time_ns")), plan.cycle_ns = atoll(value_of(json, "cycle_ns"));
    plan.cycle_wall_ns = atoll(value_of(json, "cycle_wall_ns")), plan.cycles = atoll(value_of(json, "cycles"));
    plan.hold = atoll(value_of(json, "hold_cycles"));
    while ((node = strchr(node, '/'))) node++, level++, period += strcspn(period, ",") + 1; /* One entry a tier. */
    plan.parent_period = atoll(period);
    read_deadlines(json, level);
}

int main(int count, char **words) {
    static char json[1 << 22];
    message new;
    FILE *file = count == 3 || count == 6 ? fopen(words[1], "r") : NULL;
    if (!file || !fread(json, 1, sizeof json - 1, file) || !*value_of(json, words[2]))
        return fprintf(stderr, "expected: controller PLAN.JSON NODE [RECORDER PLANT PARENT]\n"), 2;
    if (atoi(value_of(json, "protocol")) != PROTOCOL)
        return fprintf(stderr, "%s: expected a plan of protocol %d\n", words[1], PROTOCOL), 2;
    if (count == 3 && !strchr("\"", *value_of(json, "keys_folder")))
        return fprintf(stderr, "%s: expected the endpoints of a TLS gateway with a plan with keys\n", words[1]), 2;
    read_plan(json, words[2], words + 3);
    z_mutex_init(&queue.lock), z_condvar_init(&queue.wake);
    self.cycle = BEFORE_ALL;
    for (int64_t look_ns = 0;;) {
        if (now_ns() >= look_ns) look_after_links(), look_ns = now_ns() + LOOK_NS;
        bool is_timed = plan.cycle_wall_ns && self.cycle >= 0 && self.stage != IDLE;
        int64_t up_ns = self.entered_ns + (int64_t)(EARLIER * plan.deadline_ns[self.stage]);
        bool any = take(&new, is_timed && up_ns < look_ns ? up_ns : look_ns);
        if (any && new.signal == RUN && new.stops) break;
        if (any && new.signal != RUN) take_in(&new);
        if (!any && is_timed && now_ns() >= up_ns) advance(true);
    }
    printf("%s: %lld commands\n", words[2], (long long)self.sequence[COMMAND]);
    for (int to = 0; to < LINKS; to++)
        if (links[to].is_open) z_drop(z_move(links[to].token)), z_drop(z_move(links[to].session));
    return 0;
}
