"""Let a language model play a room.

A language model plays the same rooms as every other agent. It reads a description of the room and calls tools. Its
score is relative to the same best known plan.
"""

from hrl_escape import EscapeRoomEnv
from hrl_escape.text import RoomSession, ToolCall, make_model, record_game, save_games, verify_games

session = RoomSession(EscapeRoomEnv(config="four-button-chain"), reveal="places")
print(session.reset(seed=0))
session.env.instance

# The room offers three tools, as JSON Schemas. The answer to a call is text. A wrong call costs a primitive, and the
# answer lists what is valid.

print([tool["name"] for tool in session.tools()])
print(session.call("run_option", {"option": "press-button-1"}).text)
print(session.call("open_door").text)

# A model is any function from transcript and tools to a call. Here a scripted model continues, which reads only the
# transcript. Replace it by your language model.

model = make_model("search-nearest")
while not session.env.is_over:
    call = model(session.transcript, session.tools())
    assert isinstance(call, ToolCall)
    print(session.call(*call).text)

# The score contains efficiency (1 is the best known plan), calls, wrong calls, and the characters read: tools and
# transcript before every call.

print(session.score())

# A recorded game replays to the same bytes, so anyone can verify its score.

save_games("game.jsonl", [record_game(session)])
print(verify_games("game.jsonl")[0].score == session.score())

# This is the room:

session.env.unwrapped.instance
