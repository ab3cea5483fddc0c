/* Whether all of some numbers are finite: zero times any other is NaN. */
static int @{name}(const @{R} *numbers, int count)
{
    @{R} a = @{zero}, b = @{zero}, c = @{zero}, d = @{zero};
    for (int i = 0; i + 4 <= count; i += 4) {
        a = FMA(numbers[i], @{zero}, a);
        b = FMA(numbers[i + 1], @{zero}, b);
        c = FMA(numbers[i + 2], @{zero}, c);
        d = FMA(numbers[i + 3], @{zero}, d);
    }
    for (int i = count - count % 4; i < count; ++i) {
        a = FMA(numbers[i], @{zero}, a);
    }
    return (fabs@{f}((a + b) + (c + d)) <= @{zero}) ? 1 : 0;
}
