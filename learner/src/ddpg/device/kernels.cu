// The launches of `plan` on a GPU; `host` does the same number by number. Offsets count floats from the arena's start.
//
// Every sum is of fixed numbers in a fixed order: no atomics, nothing depends on which block comes first.

// Threads of a block, where a kernel does not say otherwise.
#define THREADS 256
// Parameters that one block of `sum` and `step` takes.
#define PARAMETERS 1024

typedef unsigned int u32;

// In the order of `launches::Product`.
struct Product {
    u32 a, lda, b, ldb, c, ldc;
    // Rows and columns of C; what is summed over.
    u32 m, n, k;
    // An `Activation`.
    u32 finish;
    // Forward: the bias. Back: y, of which the slope is told.
    u32 x, ldx;
    // Forward: noise on the output, 0 for none.
    u32 noise;
    // Weight: parts that k is cut into, and how far apart their sums stand.
    u32 parts, stride;
    u32 unused;
};

struct Products {
    Product product[8];
};

enum { LINEAR, RELU, TANH, OPEN_TANH };
// Y = f(A B + x); C = f'(x) (A Bᵀ); C = Aᵀ B, B's column sums behind it.
enum { FORWARD, BACK, WEIGHT };

// Comparisons are written so that what is not a number stays none.
static __device__ float activate(float sum, u32 activation) {
    if (activation == RELU) return sum < 0.0f ? 0.0f : sum;
    return activation == LINEAR ? sum : tanhf(sum);
}

// As `Activation::slope`.
static __device__ float slope(float d, float y, u32 activation) {
    if (activation == LINEAR) return d;
    if (activation == RELU) return y > 0.0f ? d : 0.0f;
    return activation == OPEN_TANH && d * y > 0.0f ? d : d * (1.0f - y * y);
}

template <int MODE>
static __device__ void finish(float *arena, const Product &p, u32 part, u32 m, u32 n, float sum) {
    if (m >= p.m || n >= p.n) return;
    if (MODE == FORWARD) {
        float y = activate(sum + arena[p.x + n], p.finish);
        if (p.noise) {
            y += arena[p.noise + m * p.n + n];
            y = y < -1.0f ? -1.0f : y > 1.0f ? 1.0f : y;
        }
        sum = y;
    }
    if (MODE == BACK) sum = slope(sum, p.finish == LINEAR ? 0.0f : arena[p.x + m * p.ldx + n], p.finish);
    arena[p.c + part * p.stride + m * p.ldc + n] = sum;
}

// Copies floats to shared memory in the background, all that there are of WIDTH; those beyond become 0.
template <int WIDTH>
static __device__ void copy(float *to, const float *from, u32 there) {
    const u32 address = (u32)__cvta_generic_to_shared(to), bytes = 4 * (there < WIDTH ? there : WIDTH);
    asm volatile("cp.async.ca.shared.global [%0], [%1], %2, %3;" ::"r"(address), "l"(from), "n"(4 * WIDTH), "r"(bytes));
}

// Ends a batch of copies.
static __device__ void end_copies() { asm volatile("cp.async.commit_group;"); }

// Waits until all but the newest COUNT batches are there.
template <int COUNT>
static __device__ void await_copies() {
    asm volatile("cp.async.wait_group %0;" ::"n"(COUNT) : "memory");
}

// Copies LINES × LENGTH numbers, LENGTH side by side in memory as in shared memory, WIDTH at a time; what is beyond
// `lines` or `length` becomes 0.
template <int ALL, int LINES, int LENGTH, int WIDTH>
static __device__ void fetch(float *to, const float *from, u32 ld, u32 lines, u32 length) {
#pragma unroll
    for (int i = 0; i < LINES * LENGTH / WIDTH; i += ALL) {
        const u32 e = threadIdx.x + i, line = e / (LENGTH / WIDTH), at = e % (LENGTH / WIDTH) * WIDTH;
        const bool there = line < lines && at < length;
        copy<WIDTH>(to + line * (LENGTH + 4) + at, there ? from + line * ld + at : from, there ? length - at : 0);
    }
}

// One factor of a tile: W rows of A or columns of B, STEP terms. BY_TERM: its terms stand side by side in memory.
template <int ALL, int W, int STEP, bool BY_TERM>
struct Factor {
    static constexpr int LINES = BY_TERM ? W : STEP, LENGTH = BY_TERM ? STEP : W, ROOM = LINES * (LENGTH + 4);

    // From the term and the row or column on at which the tile begins; `terms` and `width` are left from there.
    static __device__ void load(float *to, const float *from, u32 ld, u32 width, u32 terms) {
        const u32 lines = BY_TERM ? width : terms, length = BY_TERM ? terms : width;
        if (((size_t)from / 4 | ld) % 4 == 0)
            fetch<ALL, LINES, LENGTH, 4>(to, from, ld, lines, length);
        else
            fetch<ALL, LINES, LENGTH, 1>(to, from, ld, lines, length);
    }
};

// Number i of the EACH rows or columns that a thread of ACROSS works for.
template <int W, int EACH, bool BY_TERM>
static __device__ u32 place(u32 thread, int i) {
    // So that neighbouring threads read from different banks: every so many-th of lines, fours of what stands by line.
    return BY_TERM ? thread + i * (W / EACH) : i / 4 * (4 * W / EACH) + thread * 4 + i % 4;
}

// Four terms of the EACH rows or columns of a thread.
template <int W, int STEP, int EACH, bool BY_TERM>
static __device__ void read(float (&numbers)[4][EACH], const float *from, u32 thread, int term) {
#pragma unroll
    for (int i = 0; i < EACH; i++) {
        if (BY_TERM) {
            const float4 four = *(const float4 *)(from + place<W, EACH, true>(thread, i) * (STEP + 4) + term);
            numbers[0][i] = four.x, numbers[1][i] = four.y, numbers[2][i] = four.z, numbers[3][i] = four.w;
        } else {
            // Here the four are neighbours of one term: i stands for a term and a group of four.
            const int k = i % 4, group = i / 4;
            const float4 four = *(const float4 *)(from + (term + k) * (W + 4) + place<W, EACH, false>(thread, 4 * group));
            numbers[k][4 * group] = four.x, numbers[k][4 * group + 1] = four.y;
            numbers[k][4 * group + 2] = four.z, numbers[k][4 * group + 3] = four.w;
        }
    }
}

// One tile of one product: BM rows, BN columns; STEP terms are multiplied while those of the next STAGES − 1 steps are
// on their way. A thread keeps TM × TN sums; the threads are GROUPS groups that share out the terms.
template <int MODE, int BM, int BN, int STEP, int TM, int TN, int GROUPS, int STAGES>
static __device__ void tile(float *arena, const Products &products) {
    constexpr int ACROSS = BN / TN, GROUP = BM / TM * ACROSS, ALL = GROUP * GROUPS, SHARE = STEP / GROUPS;
    constexpr bool A_BY_TERM = MODE != WEIGHT, B_BY_TERM = MODE == BACK;
    typedef Factor<ALL, BM, STEP, A_BY_TERM> FactorA;
    typedef Factor<ALL, BN, STEP, B_BY_TERM> FactorB;
    constexpr int STAGE = FactorA::ROOM + FactorB::ROOM, SUMS = GROUPS > 1 ? GROUPS * BM * BN : 0;
    static_assert(SHARE % 4 == 0 && ALL >= BN, "shares");
    static_assert(BM * STEP / 4 % ALL == 0 && BN * STEP / 4 % ALL == 0, "shares of copies");
    __shared__ __align__(16) float shared[STAGES * STAGE > SUMS ? STAGES * STAGE : SUMS];

    u32 at = blockIdx.x, which = 0, rows, columns;
    for (;; which++) {
        const Product &p = products.product[which];
        rows = (p.m + BM - 1) / BM, columns = (p.n + BN - 1) / BN;
        if (at < rows * columns * p.parts) break;
        at -= rows * columns * p.parts;
    }
    const Product p = products.product[which];
    const u32 part = at / (rows * columns), m0 = at % (rows * columns) / columns * BM, n0 = at % columns * BN;
    const u32 length = (p.k + p.parts - 1) / p.parts, begin = part * length;
    const u32 terms = begin < p.k ? (length < p.k - begin ? length : p.k - begin) : 0;
    const u32 steps = (terms + STEP - 1) / STEP, thread = threadIdx.x;
    const float *a = arena + p.a + (A_BY_TERM ? m0 * p.lda + begin : begin * p.lda + m0);
    const float *b = arena + p.b + (B_BY_TERM ? n0 * p.ldb + begin : begin * p.ldb + n0);

    auto load = [&](u32 step) {
        if (step < steps) {
            float *stage = shared + step % STAGES * STAGE;
            const u32 k = step * STEP;
            FactorA::load(stage, a + (A_BY_TERM ? k : k * p.lda), p.lda, p.m - m0, terms - k);
            FactorB::load(stage + FactorA::ROOM, b + (B_BY_TERM ? k : k * p.ldb), p.ldb, p.n - n0, terms - k);
        }
        end_copies();
    };
    const u32 group = thread / GROUP, x = thread % GROUP % ACROSS, y = thread % GROUP / ACROSS;
    float sums[TM][TN] = {}, column = 0.0f;
    for (u32 step = 0; step + 1 < STAGES; step++) load(step);
    for (u32 step = 0; step < steps; step++) {
        await_copies<STAGES - 2>();
        __syncthreads();
        // Into the stage that all were through with before that barrier.
        load(step + STAGES - 1);
        const float *of_a = shared + step % STAGES * STAGE, *of_b = of_a + FactorA::ROOM;
#pragma unroll
        for (int term = 0; term < SHARE; term += 4) {
            float four_a[4][TM], four_b[4][TN];
            read<BM, STEP, TM, A_BY_TERM>(four_a, of_a, y, group * SHARE + term);
            read<BN, STEP, TN, B_BY_TERM>(four_b, of_b, x, group * SHARE + term);
#pragma unroll
            for (int k = 0; k < 4; k++)
#pragma unroll
                for (int i = 0; i < TM; i++)
#pragma unroll
                    for (int j = 0; j < TN; j++) sums[i][j] += four_a[k][i] * four_b[k][j];
        }
        if (MODE == WEIGHT && m0 == 0 && thread < BN)
            for (int k = 0; k < STEP; k++) column += of_b[k * (BN + 4) + thread];
    }

    if (MODE == WEIGHT && m0 == 0 && thread < BN && n0 + thread < p.n)
        arena[p.c + part * p.stride + p.m * p.n + n0 + thread] = column;
    if (GROUPS > 1) __syncthreads();
#pragma unroll
    for (int i = 0; i < TM; i++)
#pragma unroll
        for (int j = 0; j < TN; j++) {
            const u32 row = place<BM, TM, A_BY_TERM>(y, i), at_column = place<BN, TN, B_BY_TERM>(x, j);
            if (GROUPS > 1)
                shared[(group * BM + row) * BN + at_column] = sums[i][j];
            else
                finish<MODE>(arena, p, part, m0 + row, n0 + at_column, sums[i][j]);
        }
    if (GROUPS == 1) return;
    __syncthreads();
    for (u32 e = thread; e < BM * BN; e += ALL) {
        float sum = 0.0f;
        for (u32 g = 0; g < GROUPS; g++) sum += shared[g * BM * BN + e];
        finish<MODE>(arena, p, part, m0 + e / BN, n0 + e % BN, sum);
    }
}

// Small tiles for few rows, so that every multiprocessor has one; larger ones read less for each sum. Sizes are those
// that were fastest on an H200; `cuda::TILES` knows their threads.
#define PRODUCTS(NAME, MODE, TN, ALL)                                                                                  \
    extern "C" __global__ void __launch_bounds__(256) NAME##_small(float *arena, const Products products) {            \
        tile<MODE, 32, 32, 64, 4, 4, 4, 2>(arena, products);                                                           \
    }                                                                                                                  \
    extern "C" __global__ void __launch_bounds__(ALL) NAME##_medium(float *arena, const Products products) {           \
        tile<MODE, 64, 64, 16, 8, TN, 2, 3>(arena, products);                                                          \
    }
PRODUCTS(forward, FORWARD, 8, 128)
PRODUCTS(back, BACK, 4, 256)
PRODUCTS(weight, WEIGHT, 8, 128)

// In the order of `launches::Gather`.
struct Gather {
    u32 n, observation, action;
    // Columns that the minibatch becomes.
    u32 inputs, own_inputs, next_inputs, rewards, discounts;
};

// A minibatch out of the replay memory; `feed` is the update's number and a slot for each transition.
extern "C" __global__ void __launch_bounds__(THREADS)
    gather(float *arena, const float *memory, const u32 *feed, const Gather g, float reward_scale) {
    const u32 width = 2 * g.observation + g.action + 2, inputs = g.observation + g.action;
    const u32 e = blockIdx.x * THREADS + threadIdx.x, row = e / width;
    u32 column = e % width;
    if (row >= g.n) return;
    const float number = memory[(size_t)feed[1 + row] * width + column];
    if (column < g.observation) {
        arena[g.inputs + row * inputs + column] = number;
        arena[g.own_inputs + row * inputs + column] = number;
        return;
    }
    column -= g.observation;
    if (column < g.observation) {
        arena[g.next_inputs + row * inputs + column] = number;
        return;
    }
    column -= g.observation;
    if (column < g.action)
        arena[g.inputs + row * inputs + g.observation + column] = number;
    else if (column == g.action)
        arena[g.rewards + row] = reward_scale * number;
    else
        arena[g.discounts + row] = number;
}

// The sums of all threads' numbers, COUNT of them at a time, given to every thread.
template <int ALL, int COUNT>
static __device__ void all_sum(float (&numbers)[COUNT]) {
    // Each of SHARES threads adds up as many numbers as there are shares.
    constexpr int SHARES = ALL == 1024 ? 32 : 16;
    static_assert(SHARES * SHARES == ALL && COUNT * SHARES <= ALL, "shares of a sum");
    __shared__ float room[COUNT][SHARES][SHARES + 1], shares[COUNT][SHARES];
    for (int i = 0; i < COUNT; i++) room[i][threadIdx.x / SHARES][threadIdx.x % SHARES] = numbers[i];
    __syncthreads();
    if (threadIdx.x < COUNT * SHARES) {
        const u32 which = threadIdx.x / SHARES, share = threadIdx.x % SHARES;
        float sum = 0.0f;
        for (int i = 0; i < SHARES; i++) sum += room[which][share][i];
        shares[which][share] = sum;
    }
    __syncthreads();
    for (int which = 0; which < COUNT; which++) {
        numbers[which] = 0.0f;
        for (int i = 0; i < SHARES; i++) numbers[which] += shares[which][i];
    }
}

// In the order of `launches::Losses`.
struct Losses {
    u32 n, critics, moves_actor;
    // Q(s, a) and Q'(s', a') critic by critic, Q(s, π(s)).
    u32 values[2], next_values[2], own_values;
    u32 rewards, discounts, weights;
    // The losses' gradients in them.
    u32 slopes[2], own_slopes;
    // Where the errors and, an update behind the other, the losses go.
    u32 errors, report;
};

// Targets, losses and their gradients as in `losses`, by one block.
extern "C" __global__ void __launch_bounds__(1024, 1) losses(float *arena, const u32 *feed, const Losses l) {
    // Critics' loss, value, own value.
    float sums[3] = {};
    for (u32 i = threadIdx.x; i < l.n; i += 1024) {
        float next = arena[l.next_values[0] + i];
        if (l.critics == 2) {
            const float second = arena[l.next_values[1] + i];
            next = second < next || second != second ? second : next;
        }
        const float y = arena[l.rewards + i] + arena[l.discounts + i] * next, w = arena[l.weights + i];
        for (u32 c = 0; c < l.critics; c++) {
            const float error = y - arena[l.values[c] + i];
            sums[0] += w * error * error;
            arena[l.slopes[c] + i] = -2.0f / l.n * w * error;
            if (c == 0) arena[l.errors + i] = error;
        }
        sums[1] += arena[l.values[0] + i];
        if (l.moves_actor) {
            sums[2] += arena[l.own_values + i];
            arena[l.own_slopes + i] = -1.0f / l.n;
        }
    }
    all_sum<1024>(sums);
    if (threadIdx.x == 0) {
        float *report = arena + l.report + 4 * feed[0];
        report[0] = sums[0] / (l.n * l.critics);
        report[1] = -sums[2] / l.n;
        report[2] = sums[1] / l.n;
    }
}

// In the order of `launches::Moved`.
struct Moved {
    // θ; θ′, m and v stand behind it.
    u32 rows, parameters;
    // The gradient, as this many parts one behind the other; then their sum.
    u32 gradient, parts;
    // Where sums of squares of the gradient go, a block's each.
    u32 squares;
    // Rates of the next steps, and how many of them were taken before each update.
    u32 rates, taken;
    // From one row, one part to the next.
    u32 stride;
    // Share of a weight that a step leaves.
    float keep;
};

struct AllMoved {
    Moved network[3];
};

// The network that this block works for; `block` becomes its number there.
static __device__ const Moved &of_block(const AllMoved &all, u32 &block) {
    u32 which = 0;
    for (;; which++) {
        const u32 blocks = (all.network[which].parameters + PARAMETERS - 1) / PARAMETERS;
        if (block < blocks) return all.network[which];
        block -= blocks;
    }
}

// The gradients from their parts, and their squares.
extern "C" __global__ void __launch_bounds__(THREADS) sum(float *arena, const AllMoved all) {
    u32 block = blockIdx.x;
    const Moved moved = of_block(all, block);
    float squares[1] = {};
    for (u32 i = threadIdx.x; i < PARAMETERS; i += THREADS) {
        const u32 at = block * PARAMETERS + i;
        if (at >= moved.parameters) break;
        float g = 0.0f;
        for (u32 part = 0; part < moved.parts; part++) g += arena[moved.gradient + part * moved.stride + at];
        arena[moved.gradient + at] = g;
        squares[0] += g * g;
    }
    all_sum<THREADS>(squares);
    if (threadIdx.x == 0) arena[moved.squares + block] = squares[0];
}

// Adam and the target copies as in `optimizer`, unless a loss or gradient is not finite; one block says which it was.
extern "C" __global__ void __launch_bounds__(THREADS) step(float *arena, const u32 *feed, const AllMoved all,
                                                           u32 networks, u32 resting, u32 report, float clip,
                                                           float target_rate, u32 moves_targets) {
    constexpr int EACH = PARAMETERS / THREADS;
    u32 block = blockIdx.x;
    const Moved moved = of_block(all, block);
    // All that a thread moves is on its way while the norms are added up.
    float *weights = arena + moved.rows, *targets = weights + moved.stride;
    float *means = targets + moved.stride, *squares = means + moved.stride;
    float g[EACH], m[EACH], v[EACH], w[EACH], t[EACH];
#pragma unroll
    for (int i = 0; i < EACH; i++) {
        const u32 at = block * PARAMETERS + i * THREADS + threadIdx.x;
        if (at >= moved.parameters) break;
        g[i] = arena[moved.gradient + at], m[i] = means[at], v[i] = squares[at], w[i] = weights[at], t[i] = targets[at];
    }
    const u32 update = feed[0];
    float *found = arena + report + 4 * update;
    bool ok = isfinite(found[0]) && isfinite(found[1]) && isfinite(found[2]);
    const float *taken = arena + moved.taken + update;
    const float taken_before = taken[0];
    const float rate = arena[moved.rates + 2 * (u32)taken_before];
    const float root_scale = arena[moved.rates + 2 * (u32)taken_before + 1];
    float lengths[3] = {}, scale = 1.0f;
    for (u32 which = 0; which < networks; which++) {
        const u32 blocks = (all.network[which].parameters + PARAMETERS - 1) / PARAMETERS;
        for (u32 i = threadIdx.x; i < blocks; i += THREADS) lengths[which] += arena[all.network[which].squares + i];
    }
    all_sum<THREADS>(lengths);
    for (u32 which = 0; which < networks; which++) {
        const float norm = sqrtf(lengths[which]);
        ok = ok && isfinite(norm);
        if (all.network[which].rows == moved.rows && clip > 0.0f && norm > clip) scale = clip / norm;
    }
    if (block == 0 && threadIdx.x == 0) {
        arena[moved.taken + update + 1] = taken_before + (ok ? 1.0f : 0.0f);
        if (resting) arena[resting + update + 1] = arena[resting + update];
        found[3] = ok ? 1.0f : 0.0f;
    }
    if (!ok) return;
#pragma unroll
    for (int i = 0; i < EACH; i++) {
        const u32 at = block * PARAMETERS + i * THREADS + threadIdx.x;
        if (at >= moved.parameters) return;
        const float clipped = g[i] * scale;
        const float mean = 0.9f * m[i] + (float)(1.0 - 0.9) * clipped;
        const float square = 0.999f * v[i] + (float)(1.0 - 0.999) * clipped * clipped;
        const float weight = moved.keep * w[i] - rate * mean / (sqrtf(square) * root_scale + 1e-8f);
        means[at] = mean, squares[at] = square, weights[at] = weight;
        if (moves_targets) targets[at] = t[i] + target_rate * (weight - t[i]);
    }
}
