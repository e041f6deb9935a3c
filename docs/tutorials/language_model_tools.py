"""A language model's tools.

An agent that speaks plays the same rooms as every other agent. It reads what a room says, and calls tools; the score is
measured against the same best known plan.
"""

from hrl_escape import EscapeRoomEnv
from hrl_escape.text import RoomSession, ToolCall, make_model, record_game, save_games, verify_games

session = RoomSession(EscapeRoomEnv(config="four-button-chain"), reveal="places")
print(session.reset(seed=0))
session.env.instance

# Three tools are offered, as JSON Schemas. A call is answered in words; a wrong one costs a primitive, and the answer
# says what would have been valid.

print([tool["name"] for tool in session.tools()])
print(session.call("run_option", {"option": "press-button-1"}).text)
print(session.call("open_door").text)

# A caller is any function from transcript and tools to a call. Here a scripted manager goes on, which reads nothing but
# the transcript; put your language model in its place.

model = make_model("search-nearest")
while not session.env.is_over:
    call = model(session.transcript, session.tools())
    assert isinstance(call, ToolCall)
    print(session.call(*call).text)

# The score holds efficiency (1 is the best known plan), calls, wrong calls, and the characters that the caller has
# read: tools and transcript anew before every call.

print(session.score())

# A recorded game replays to the same bytes, so that nobody needs to take a score on trust.

save_games("game.jsonl", [record_game(session)])
print(verify_games("game.jsonl")[0].score == session.score())

# The room that it was:

session.env.unwrapped.instance
