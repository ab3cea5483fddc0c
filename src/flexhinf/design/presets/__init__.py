"""Ask for behaviour, not weights: presets that find a penalty, by a search over the linear part."""
