// Exclusive prefix sum in place; the last element becomes the total of those before it.
//
// One workgroup walks over the array: a step takes 4096 numbers, sixteen a thread. The arrays here
// are short (digits times blocks, or one number a Gaussian).

const THREADS: u32 = 256u;
const EACH: u32 = 16u;

@group(0) @binding(0) var<storage, read_write> numbers: array<u32>;

var<workgroup> sums: array<u32, THREADS>;

@compute @workgroup_size(256)
fn scan(@builtin(local_invocation_index) thread: u32) {
    let length = arrayLength(&numbers);
    // The same in every thread, as each adds up the same steps.
    var before = 0u;
    for (var first = 0u; first < length; first += THREADS * EACH) {
        let own = first + thread * EACH;
        var values: array<u32, EACH>;
        var sum = 0u;
        for (var k = 0u; k < EACH; k++) {
            if own + k + 1u < length {
                values[k] = numbers[own + k];
            }
            sum += values[k];
        }
        workgroupBarrier();
        sums[thread] = sum;
        for (var step = 1u; step < THREADS; step *= 2u) {
            workgroupBarrier();
            var left = 0u;
            if thread >= step {
                left = sums[thread - step];
            }
            workgroupBarrier();
            sums[thread] += left;
        }
        workgroupBarrier();
        var at = before + sums[thread] - sum;
        for (var k = 0u; k < EACH; k++) {
            if own + k < length {
                numbers[own + k] = at;
            }
            at += values[k];
        }
        before += sums[THREADS - 1u];
    }
}
