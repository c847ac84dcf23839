"""What a planner does with several places: follow a way that is free at all of them.

Needs a running robot, such as `clustermcl up --set bridge.source=sim:office`.
"""

from clustermcl import Client

with Client() as client:
    answer = client.pose()
    if answer.state == "localized" and answer.freshness == "fresh":
        print(f"plan with {answer.pose}; keep two standard deviations more from walls")
    else:
        advice = client.advice()
        print(f"{len(advice.places)} places, {answer.state}: {advice.note or 'drive to see more'}")
        for way in advice.ways[:1]:
            ahead_m, left_m, _ = way.poses[-1]  # from where the robot was at `advice.step`
            print(f"drive to {ahead_m:.1f} m ahead, {left_m:.1f} m to the left")
            print(f"then localized with probability {way.sure_probability:.2f}")
