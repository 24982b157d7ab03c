"""Queries in words, what answers them by the names of the categories, and what a person would not mind."""

HDM, UTD, BANDAI = "hdm05:", "utd:", "bandai:"
RUNS = {HDM + "jogLeftCircle4StepsRstart", UTD + "jog", BANDAI + "run"}
SQUATS = {HDM + "squat1Reps", UTD + "squat"}
BOWS = {HDM + "depositFloorR", UTD + "pickup_throw", HDM + "lieDownFloor", UTD + "lunge"}
BALLS = {HDM + "throwBasketball", UTD + "basketball_shoot"}
UP = {BANDAI + "raise-up-both-hands", BANDAI + "wave-both-hands"}

QUESTIONS = (
    # (query, wanted, tolerated)
    ("somebody does squats", SQUATS, BOWS),
    ("hop with both legs", {HDM + "hopBothLegs1hops"}, set()),
    ("tennis", {UTD + "tennis_serve", UTD + "tennis_swing"}, set()),
    ("applause", {UTD + "clap"}, set()),
    ("lying down on the ground", {HDM + "lieDownFloor"}, set()),
    ("joging", {HDM + "jogLeftCircle4StepsRstart", UTD + "jog"}, {BANDAI + "run"}),
    ("baskettball", BALLS, set()),
    ("drawing a trianlge", {UTD + "draw_triangle"}, set()),
    ("wave with the left hand", {BANDAI + "wave-left-hand"}, set()),
    ("getting up from a chair", {UTD + "sit_to_stand"}, set()),
    ("walk and trun right", {BANDAI + "walk-turn-right"}, set()),
    ("play the piano", set(), set()),
    ("しゃがむ", SQUATS, BOWS),
    ("左足で前に蹴る", {HDM + "kickLFront1Reps"}, set()),
    ("椅子に腰掛ける", {UTD + "stand_to_sit"}, set()),
    ("ボクシング", {UTD + "boxing"}, set()),
    ("両手を挙げる", {BANDAI + "raise-up-both-hands"}, UP | BALLS | {UTD + "tennis_serve"}),
    ("ドアをノックする", {UTD + "knock"}, set()),
    ("バスケットポール", BALLS, set()),
    ("平泳ぎ", set(), set()),
)
