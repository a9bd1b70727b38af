package rcp

import (
	"bytes"
	"context"
	"crypto/rand"
	"encoding/hex"
	"encoding/json"
	"fmt"
	"io"
	"net/http"
	"strings"
	"unicode"
)

// Error is what the gateway refused or failed to do.
type Error struct {
	Code      string `json:"code"`
	Message   string `json:"message"`
	Remedy    string `json:"remedy"`
	Retryable bool   `json:"retryable"`
}

func (e *Error) Error() string { return fmt.Sprintf("%s: %s", e.Code, e.Message) }

// Gateway is a gateway, over HTTP and server-sent events.
type Gateway struct {
	// Client sends the requests; its Transport has what is needed for TLS.
	Client *http.Client
	base   string
	token  string
}

// New returns a gateway; nothing is sent yet. The token may be empty.
func New(url, token string) *Gateway {
	return &Gateway{http.DefaultClient, strings.TrimRight(url, "/") + "/rcp/v1", token}
}

type reply struct {
	Status  string          `json:"status"`
	Command string          `json:"command"`
	Body    json.RawMessage `json:"body"`
	Error   *Error          `json:"error"`
}

type keyed struct{}

// WithKey names what is written or executed under the context. The gateway acts once for a key, also when the same
// is sent again after a lost connection, or by a program that was started again, and answers with the first outcome.
func WithKey(ctx context.Context, key string) context.Context {
	return context.WithValue(ctx, keyed{}, key)
}

// keyOf returns the key of a context, or "".
func keyOf(ctx context.Context) string {
	key, _ := ctx.Value(keyed{}).(string)
	return key
}

func newKey() string {
	random := make([]byte, 16)
	if _, err := rand.Read(random); err != nil {
		panic(err)
	}
	return hex.EncodeToString(random)
}

func (g *Gateway) open(ctx context.Context, method, path string, body any) (*http.Response, error) {
	return g.openAs(ctx, method, path, body, nil)
}

func (g *Gateway) openAs(ctx context.Context, method, path string, body any, header map[string]string) (*http.Response, error) {
	var content io.Reader
	if body != nil {
		data, err := json.Marshal(body)
		if err != nil {
			return nil, err
		}
		content = bytes.NewReader(data)
	}
	if !printable(g.token) {
		return nil, &Error{Code: "bad_request", Message: "a token has no control characters, such as the line break that a file ends with"}
	}
	for name, value := range header {
		if !printable(value) {
			return nil, &Error{Code: "bad_request", Message: name + " has no control characters"}
		}
	}
	request, err := http.NewRequestWithContext(ctx, method, g.base+path, content)
	if err != nil {
		return nil, err
	}
	if body != nil {
		request.Header.Set("Content-Type", "application/json")
	}
	if g.token != "" {
		request.Header.Set("Authorization", "Bearer "+g.token)
	}
	for name, value := range header {
		request.Header.Set(name, value)
	}
	return g.Client.Do(request)
}

// printable is whether a text can be sent in a header; net/http refuses others with what looks like a lost connection.
func printable(text string) bool { return strings.IndexFunc(text, unicode.IsControl) < 0 }

func decoded(response *http.Response) (reply, error) {
	var found reply
	if err := json.NewDecoder(response.Body).Decode(&found); err != nil {
		return found, fmt.Errorf("HTTP %d: %w", response.StatusCode, err)
	}
	if found.Error != nil {
		return found, found.Error
	}
	if found.Status == "" { // a proxy that has no gateway behind it speaks JSON too
		return found, fmt.Errorf("HTTP %d: not an answer of a gateway", response.StatusCode)
	}
	return found, nil
}

// done is the answer to what ends with it.
func done(found reply, err error) (reply, error) {
	if err == nil && found.Status != "completed" {
		err = fmt.Errorf("the gateway answered `%s`, not `completed`", found.Status)
	}
	return found, err
}

func (g *Gateway) ask(ctx context.Context, method, path string, body any) (reply, error) {
	return g.askAs(ctx, method, path, body, nil)
}

// once sends what acts, under a key if there is one; net/http itself may send that again.
func (g *Gateway) once(ctx context.Context, key, method, path string, body any) (reply, error) {
	if key == "" {
		return g.ask(ctx, method, path, body)
	}
	return g.askAs(ctx, method, path, body, map[string]string{"Idempotency-Key": key})
}

func (g *Gateway) askAs(ctx context.Context, method, path string, body any, header map[string]string) (reply, error) {
	response, err := g.openAs(ctx, method, path, body, header)
	if err != nil {
		return reply{}, err
	}
	defer response.Body.Close()
	return decoded(response)
}

func into[T any](body json.RawMessage) (T, error) {
	var value T
	if len(body) == 0 {
		return value, nil
	}
	err := decode(body, &value)
	return value, err
}
