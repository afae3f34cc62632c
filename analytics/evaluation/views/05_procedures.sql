-- What the name of a procedure says of its steps. Files bring names of their own: only a name that is one of the
-- program's procedures, or the family of one, makes a step what that procedure measures; a name that only begins alike
-- (power_cycling, range_soak) does not.

-- Steps at rest of these are no records of a bias.
create or replace macro is_no_bias_procedure("procedure") as
  regexp_full_match(coalesce("procedure", ''),
    '(power_consumption|rates_(gjb2426a|jjf2014)|threshold(_indexing_head|_slow_turn)?|resolution|polarity'
    '|visual_electrical_checks)')
  or regexp_matches(coalesce("procedure", ''),
    '^(scale_factor|misalignment|gyro_separation|accelerometer_separation|attitude_unit|bandwidth|output_delay'
    '|startup_time|warmup_time|random_walk|system_level|bias_(temperature|acceleration|shock|vibration))');

create or replace macro is_scale_factor_procedure("procedure") as
  regexp_matches(coalesce("procedure", ''), '^(scale_factor|rates_|attitude_unit_scale_factor)');

-- Rates of these are no points of a scale factor.
create or replace macro is_other_procedure("procedure") as
  regexp_full_match(coalesce("procedure", ''),
    '(power_consumption|visual_electrical_checks|static_bias|allan_variance|random_walk|bias_[a-z0-9_]+)')
  or regexp_matches(coalesce("procedure", ''), '^(threshold|resolution|misalignment|polarity|startup_time|warmup_time'
    '|gyro_sep|accelerometer_sep|attitude_unit_|bandwidth|output_delay|system_level)|阈值|分辨率|失准角|极性|零偏');
